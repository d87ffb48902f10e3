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
from pipeline.formats.exr_frame import exr_frame
from pipeline.formats.images import open_image, read_stored, reason_of
from stages.olat.reading.scanline_bands import Band, Picked, Turn, picked
from stages.olat.reading.zip_frames import ZipFrames

READERS = 2
T = TypeVar("T")


@dataclass
class Samples:
    """What a band holds: cross and parallel [N, P, 3], half-float bits (uint16) or float32."""

    band: Band
    cross: NDArray
    parallel: NDArray


def is_half(path: Path) -> bool:
    """Whether a frame stores half floats that are its picture. Raises UserError."""
    image, spec = _open(path)
    image.close()
    return str(spec.format) == "half" and exr_frame(spec, path).colour is None


def read_bands(
    cross: list[Path],
    parallel: list[Path],
    bands: list[Band],
    size: tuple[int, int],
    half: bool,
    readers: int = READERS,
    shift: tuple[float, float] = (0, 0),
    turn: Turn | None = None,
) -> Iterator[Samples]:
    """The samples of each band of frames of this size (width, height); the next is read while the caller works on this one.

    shift, turn: pixels (right, down) by which the parallel pass lies off the crossed one and how it is turned, undone on
    reading to whole pixels (those beyond the edge repeat it). Raises UserError.
    """
    with ThreadPoolExecutor(readers) as pool:
        yield from ahead(read_band(pool, readers, cross, parallel, band, size, half, shift, turn) for band in bands)


def read_band(
    pool: ThreadPoolExecutor, readers: int, cross: list[Path], parallel: list[Path], band: Band, size: tuple[int, int],
    half: bool, shift: tuple[float, float], turn: Turn | None = None,
) -> Samples:  # fmt: skip
    """The samples of one band, read by the `readers` threads of `pool`. See `read_bands`."""
    buffer = np.empty((2, len(cross), len(band.pixels), 3), np.uint16 if half else np.float32)
    passes = ((cross, picked(band, *size)), (parallel, picked(band, *size, shift, turn)))
    frames = [(path, pixels, out) for (paths, pixels), side in zip(passes, buffer) for path, out in zip(paths, side)]
    parts = 4 * readers
    tasks = [pool.submit(_read_part, frames[k::parts], half) for k in range(parts)]
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


def _read_part(frames: list[tuple[Path, Picked, NDArray]], half: bool) -> None:
    reader = ZipFrames()
    for path, pixels, out in frames:
        found = out if pixels.order is None else np.empty_like(out)
        if not reader.read(path, pixels, half, found):
            rows = read_rows(path, pixels.top, pixels.bottom, pixels.width, pixels.height, half)
            row = np.repeat(np.arange(pixels.bottom - pixels.top), np.diff(pixels.starts))
            np.take(rows.reshape(-1, 3), row * pixels.width + pixels.columns, axis=0, out=found, mode="clip")
        if pixels.order is not None:
            out[pixels.order] = found


def read_rows(path: Path, top: int, bottom: int, width: int, height: int, half: bool) -> NDArray:
    """Scanlines [top, bottom) of a frame's R, G, B: [rows, W, 3] uint16 (half bits) or float32. Raises UserError."""
    image, spec = _open(path)
    frame = exr_frame(spec, path)
    if frame.size != (width, height):
        image.close()
        fault = f"is {frame.size[0]}x{frame.size[1]}, this camera's other frames {width}x{height}"
        raise UserError(path, fault, "export all frames of a camera alike")
    kind = "half" if half else "float"
    if not frame.is_plain or spec.x or spec.y:
        image.close()
        return _picture_rows(path, top, bottom, half)
    if spec.tile_width:
        low, high = top - top % spec.tile_height, min(-(-bottom // spec.tile_height) * spec.tile_height, spec.height)
        pixels = image.read_tiles(0, 0, 0, spec.width, low, high, 0, 1, 0, spec.nchannels, kind)
        top, bottom = top - low, bottom - low
        pixels = None if pixels is None else np.asarray(pixels).reshape(high - low, spec.width, -1)[top:bottom]
    else:
        pixels = image.read_scanlines(0, 0, top, bottom, 0, 0, spec.nchannels, kind)
        pixels = None if pixels is None else np.asarray(pixels).reshape(bottom - top, spec.width, -1)
    reason = reason_of(image) if pixels is None else ""
    image.close()
    if pixels is None:
        raise UserError(path, f"the image is truncated or corrupt ({reason})", "copy it again from its source")
    return _rgb(pixels, list(spec.channelnames), path).view(np.uint16 if half else np.float32)


def _picture_rows(path: Path, top: int, bottom: int, half: bool) -> NDArray:
    """The same of a frame whose stored pixels are not its picture: read whole. Raises UserError."""
    pixels, names, _ = read_stored(path, plain=True)
    rows = _rgb(pixels[top:bottom], names, path).astype(np.float16 if half else np.float32)
    return rows.view(np.uint16 if half else np.float32)


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
    if not path.is_file():
        raise UserError(path, "no such frame", "run decode again, or copy the frame back")
    image = open_image(path, plain=True)
    return image, image.spec()
