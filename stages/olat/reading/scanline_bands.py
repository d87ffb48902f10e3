"""Bands of scanlines in which a camera is read and fitted, and which of their pixels are picked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PART = 4000  # pixels fitted before they are written: a tenth of a second
CHUNK_ROWS = 16  # scanlines that EXR's zip compresses together: a band that splits them reads them twice


@dataclass(frozen=True)
class Band:
    """Scanlines [top, bottom) of a camera and the mask's pixels in them: `pixels` are indices row * width + column."""

    top: int
    bottom: int
    pixels: NDArray[np.intp]


@dataclass(frozen=True)
class Picked:
    """Pixels of a frame of this size: rows [top, bottom), row y's in `columns` int32 [P] from starts[y - top] on, int64."""

    width: int
    height: int
    top: int
    bottom: int
    starts: NDArray[np.int64]
    columns: NDArray[np.int32]


def picked(band: Band, width: int, height: int, shift: tuple[int, int] = (0, 0)) -> Picked:
    """A band's pixels `shift` (right, down) further on in a frame of this size; those beyond its edge are the edge's."""
    rows, columns = np.divmod(band.pixels, width)
    rows = np.clip(rows + shift[1], 0, height - 1)
    columns = np.clip(columns + shift[0], 0, width - 1).astype(np.int32)
    top, bottom = (int(rows[0]), int(rows[-1]) + 1) if len(rows) else (0, 0)
    return Picked(width, height, top, bottom, np.searchsorted(rows, np.arange(top, bottom + 1)), columns)


def bands_of(mask: NDArray[np.bool_], lights: int, band_mb: float, itemsize: int) -> list[Band]:
    """Bands of whole compression chunks, each with at most `band_mb` MiB of samples (or one chunk), from the first to the last
    chunk that holds any."""
    per_pixel = lights * 6 * itemsize / 2**20
    width = mask.shape[1]
    rows = mask.sum(1)
    height = min(-(-(int(np.flatnonzero(rows)[-1]) + 1) // CHUNK_ROWS) * CHUNK_ROWS, len(mask)) if rows.any() else 0
    bands: list[Band] = []
    top = 0
    while top < height:
        bottom, count = top, 0
        while bottom < height:
            end = min(bottom + CHUNK_ROWS, height)
            more = int(rows[bottom:end].sum())
            if bottom > top and (count + more) * per_pixel > band_mb:
                break
            if count == 0 and more == 0 and bottom == top:
                top = bottom = end
                continue
            bottom, count = end, count + more
        if count:
            pixels = np.flatnonzero(mask[top:bottom]) + top * width
            bands.append(Band(top, bottom, pixels))
        top = bottom
    return bands


def parts_of(band: Band, width: int) -> list[Band]:
    """A band as parts of whole scanlines, each with about `PART` pixels or more."""
    count = max(1, len(band.pixels) // PART)
    wanted = (np.arange(1, count) * len(band.pixels)) // count
    edges = np.unique([band.top, *(band.pixels[wanted] // width), band.bottom])
    inside = np.searchsorted(band.pixels, edges * width)
    return [
        Band(int(edges[k]), int(edges[k + 1]), band.pixels[inside[k] : inside[k + 1]])
        for k in range(len(edges) - 1)
        if inside[k + 1] > inside[k]
    ]
