"""Pixels to a file through OpenImageIO: whole, or a fault that says why not."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import UserError

HALF_ROWS = 64


def oiio_library() -> Any:
    """OpenImageIO, loaded where it is first used."""
    import OpenImageIO as oiio

    return oiio


def reason_of(library: Any) -> str:
    """Take from OpenImageIO what it says of its last fault, and clear it.

    Args:
        library: the OpenImageIO module, or one of its open images.

    Returns:
        One line; of a garbled file, whose message may be no text, a line of our own.
    """
    try:
        said = str(library.geterror()).strip().splitlines()
    except UnicodeDecodeError:
        return "its header is garbled"
    return said[0] if said else "no reason given"


def write_pixels(path: Path, pixels: np.ndarray, kind: str, names: list[str], attributes: dict[str, str | int]) -> None:
    """Write pixels [H, W, C] as `kind` (half, float, uint8), channels by name. Raises UserError where it cannot."""
    oiio = oiio_library()
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, kind)
    spec.channelnames = tuple(names)
    spec.attribute("DateTime", "2000:01:01 00:00:00")  # otherwise the clock would change the bytes
    for key, value in attributes.items():
        spec.attribute(key, value)
    path.parent.mkdir(parents=True, exist_ok=True)
    out = oiio.ImageOutput.create(str(path))
    if out is None:
        raise write_fault(path, reason_of(oiio))
    # OpenImageIO takes a file that could not be written to its end for written: made in memory, written by what tells.
    in_memory = _in_memory if hasattr(os, "memfd_create") else _in_temporary_folder
    try:
        if not in_memory(lambda name: _encode(out, name, spec, pixels, kind), path):
            raise write_fault(path, reason_of(out))
    except OSError as error:
        raise write_fault(path, error.strerror or str(error)) from error


def _in_memory(encode: Callable[[str], bool], path: Path) -> bool:
    """Write to `path` what `encode` writes to the file it is told; whether it did. That file is memory alone (Linux)."""
    handle = os.memfd_create(path.name[:100])
    try:
        if not encode(f"/proc/self/fd/{handle}"):
            return False
        os.lseek(handle, 0, os.SEEK_SET)
        with open(handle, "rb", closefd=False) as stream, path.open("wb") as out:
            shutil.copyfileobj(stream, out, 1 << 20)
        return True
    finally:
        os.close(handle)


def _in_temporary_folder(encode: Callable[[str], bool], path: Path) -> bool:
    """As `_in_memory`, where there are no such files: on disk, and read again, as a full disk is told by nothing else."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        again = oiio_library().ImageInput.open(str(file)) if encode(str(file)) else None
        if again is None or again.read_image() is None:
            return False
        again.close()
        path.write_bytes(file.read_bytes())
        return True


def _encode(out, name: str, spec, pixels: np.ndarray, kind: str) -> bool:
    """Write an image to a file of any name; returns whether OpenImageIO says that it did."""
    done = out.open(name, spec) and _put(out, pixels, kind)
    return bool(out.close() and done)


def _put(out, pixels: np.ndarray, kind: str) -> bool:
    """Write all pixels; halves a band at a time, as numpy narrows them in a fifth of OpenImageIO's time."""
    if kind != "half":
        return out.write_image(pixels)
    bands = ((y, min(y + HALF_ROWS, len(pixels))) for y in range(0, len(pixels), HALF_ROWS))
    return all(out.write_scanlines(y, end, 0, pixels[y:end].astype(np.float16)) for y, end in bands)


def write_fault(path: Path, reason: str) -> UserError:
    """Say why a file could not be written: no space, a read-only target, or what the library says.

    Args:
        path: the file that failed.
        reason: what the library says.

    Returns:
        The error, for the caller to raise.
    """
    folder = next((p for p in path.parents if p.exists()), Path("."))
    if shutil.disk_usage(folder).free < 1 << 20:
        return UserError(path, "no space left on the target", "free some space or choose another DATASET=")
    if not os.access(folder, os.W_OK):
        return UserError(path, "the target is read-only", "choose a writable DATASET=")
    return UserError(path, f"cannot be written ({reason})", "check the target folder")
