"""Bands of scanlines in which a camera is read and fitted, and which of their pixels are picked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

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


class Turn(NamedTuple):
    """A turn in the picture: radians from right to down, about a place."""

    radians: float
    column: float
    row: float


@dataclass(frozen=True)
class Picked:
    """Pixels of a frame of this size: rows [top, bottom), row y's in `columns` int32 [P] from starts[y - top] on, int64.

    order: which of the band's pixels each is, where these are not in the band's own order. [P]
    """

    width: int
    height: int
    top: int
    bottom: int
    starts: NDArray[np.int64]
    columns: NDArray[np.int32]
    order: NDArray[np.intp] | None = None


def picked(
    band: Band, width: int, height: int, shift: tuple[float, float] = (0, 0), turn: Turn | None = None
) -> Picked:  # fmt: skip
    """A band's pixels where `turn` and `shift` (right, down) bring them in a frame of this size, to the nearest whole ones;
    those beyond its edge are the edge's."""
    rows, columns = np.divmod(band.pixels, width)
    down, right = np.full(len(rows), shift[1], float), np.full(len(rows), shift[0], float)
    order = None
    if turn is not None:
        c, s = np.cos(turn.radians) - 1, np.sin(turn.radians)
        down += s * (columns - turn.column) + c * (rows - turn.row)
        right += c * (columns - turn.column) - s * (rows - turn.row)
    rows = np.clip(rows + np.rint(down).astype(np.intp), 0, height - 1)
    columns = np.clip(columns + np.rint(right).astype(np.intp), 0, width - 1).astype(np.int32)
    if turn is not None:
        order = np.lexsort((columns, rows))
        rows, columns = rows[order], columns[order]
    top, bottom = (int(rows[0]), int(rows[-1]) + 1) if len(rows) else (0, 0)
    return Picked(width, height, top, bottom, np.searchsorted(rows, np.arange(top, bottom + 1)), columns, order)


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
