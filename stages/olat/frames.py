"""Frames of one camera, read in bands of scanlines: only the pixels inside the mask are kept, half floats stay half floats."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError

CHUNK_ROWS = 16  # scanlines that EXR's zip compresses together: a band that splits them reads them twice
READERS = 2
T = TypeVar("T")


@dataclass(frozen=True)
class Band:
    """Scanlines [top, bottom) of a camera and the mask's pixels in them: `pixels` are indices row * width + column."""

    top: int
    bottom: int
    pixels: NDArray[np.intp]


@dataclass
class Samples:
    """What a band holds: cross and parallel [N, P, 3], half-float bits (uint16) or float32."""

    band: Band
    cross: NDArray
    parallel: NDArray


def bands_of(mask: NDArray[np.bool_], lights: int, band_mb: float, itemsize: int) -> list[Band]:
    """Bands of whole compression chunks, each with at most `band_mb` MiB of samples (or one chunk), none empty."""
    per_pixel = lights * 6 * itemsize / 2**20
    height, width = mask.shape
    rows = mask.sum(1)
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


def is_half(path: Path) -> bool:
    """Whether a frame stores half floats. Raises UserError."""
    image, spec = _open(path)
    image.close()
    return str(spec.format) == "half"


def read_bands(
    cross: list[Path],
    parallel: list[Path],
    bands: list[Band],
    half: bool,
    readers: int = READERS,
    shift: tuple[int, int] = (0, 0),
    height: int = 0,
) -> Iterator[Samples]:
    """The samples of each band in turn; the next band is read while the caller works on this one.

    shift: whole pixels (right, down) by which the parallel pass lies off the crossed one, undone on reading (`height`: of the
    frames; pixels beyond their edge repeat it). Raises UserError.
    """
    with ThreadPoolExecutor(readers) as pool:
        yield from ahead(read_band(pool, readers, cross, parallel, band, half, shift, height) for band in bands)


def read_band(
    pool: ThreadPoolExecutor, readers: int, cross: list[Path], parallel: list[Path], band: Band, half: bool,
    shift: tuple[int, int], height: int,
) -> Samples:  # fmt: skip
    """The samples of one band, read by the `readers` threads of `pool`. See `read_bands`."""
    frames, count, parts = [*cross, *parallel], len(cross), 4 * readers
    buffer = np.empty((2, count, len(band.pixels), 3), np.uint16 if half else np.float32)
    flat = buffer.reshape(2 * count, len(band.pixels), 3)
    places = [range(2 * count)[k::parts] for k in range(parts)]
    moves = [[shift if k >= count else (0, 0) for k in place] for place in places]
    tasks = [
        pool.submit(_read_part, frames[k::parts], places[k], moves[k], band, half, height, flat) for k in range(parts)
    ]  # fmt: skip
    try:
        for task in tasks:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
    return Samples(band, buffer[0], buffer[1])


def ahead(items: Iterator[T]) -> Generator[T, None, None]:
    """The same items, each made by a thread while the caller holds the one before; the first is begun at once.

    Never more than two exist: one with the caller, one being made or waiting.
    """
    pool = ThreadPoolExecutor(1)

    def hand_over(made: Future[T | None]) -> Generator[T, None, None]:
        try:
            while (item := made.result()) is not None:
                made = pool.submit(next, items, None)
                yield item
                del item
        finally:
            made.cancel()
            pool.shutdown(wait=True)

    return hand_over(pool.submit(next, items, None))


def _read_part(
    paths: list[Path], places: range, moves: list[tuple[int, int]], band: Band, half: bool, height: int, out: NDArray
) -> None:
    for path, place, (right, down) in zip(paths, places, moves):
        if not (right or down):
            rows = read_rows(path, band.top, band.bottom, half)
            inside = band.pixels - band.top * rows.shape[1]
            np.take(rows.reshape(-1, 3), inside, axis=0, out=out[place], mode="clip")  # 7 times as fast as indexing
            continue
        top = min(max(band.top + down, 0), height - 1)
        bottom = max(min(band.bottom + down, height), top + 1)
        rows = read_rows(path, top, bottom, half)
        row, column = np.divmod(band.pixels, rows.shape[1])
        row, column = np.clip(row + down, top, bottom - 1) - top, np.clip(column + right, 0, rows.shape[1] - 1)
        out[place] = rows[row, column]


def read_rows(path: Path, top: int, bottom: int, half: bool) -> NDArray:
    """Scanlines [top, bottom) of a frame's R, G, B: [rows, W, 3] uint16 (half bits) or float32. Raises UserError."""
    image, spec = _open(path)
    kind = "half" if half else "float"
    if spec.tile_width:
        low, high = top - top % spec.tile_height, min(-(-bottom // spec.tile_height) * spec.tile_height, spec.height)
        pixels = image.read_tiles(0, 0, 0, spec.width, low, high, 0, 1, 0, spec.nchannels, kind)
        top, bottom = top - low, bottom - low
        pixels = None if pixels is None else np.asarray(pixels).reshape(high - low, spec.width, -1)[top:bottom]
    else:
        pixels = image.read_scanlines(0, 0, top, bottom, 0, 0, spec.nchannels, kind)
        pixels = None if pixels is None else np.asarray(pixels).reshape(bottom - top, spec.width, -1)
    error = image.geterror() if pixels is None else ""
    image.close()
    if pixels is None:
        reason = (error.strip().splitlines() or ["no reason given"])[0]
        raise UserError(path, f"the image is truncated or corrupt ({reason})", "copy it again from its source")
    return _rgb(pixels, list(spec.channelnames), path).view(np.uint16 if half else np.float32)


def _rgb(pixels: NDArray, names: list[str], path: Path) -> NDArray:
    """R, G, B by name; a single channel stands for all three."""
    lower = [name.lower() for name in names]
    if lower[:3] == ["r", "g", "b"]:
        return np.ascontiguousarray(pixels[..., :3])
    if {"r", "g", "b"} <= set(lower):
        return np.ascontiguousarray(pixels[..., [lower.index(c) for c in "rgb"]])
    if len(names) == 1:
        return np.ascontiguousarray(np.repeat(pixels, 3, axis=-1))
    raise UserError(path, f"has channels {', '.join(names)}, not R G B", "export RGB frames")


def _open(path: Path):
    import OpenImageIO as oiio

    if not path.is_file():
        raise UserError(path, "no such frame", "run decode again, or copy the frame back")
    image = oiio.ImageInput.open(str(path))
    if image is None:
        reason = (oiio.geterror().strip().splitlines() or ["no reason given"])[0]
        raise UserError(path, f"cannot be read as an image ({reason})", "copy it again from its source")
    return image, image.spec()
