"""NumPy files of strangers: headers first, only the arrays asked for, no more than a sane size, no objects."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError

LARGEST = 1 << 31
"""Bytes of one array: 130 megapixels of three floats, 65 of three doubles."""
LONGEST_REASON = 200  # characters: zipfile quotes a garbled header whole
AGAIN = "copy it again from its source"
Header = tuple[tuple[int, ...], np.dtype[Any], bool]


def array_names(path: Path) -> list[str]:
    """Name the arrays that an .npz holds, from its table of contents alone.

    Args:
        path: the .npz.

    Returns:
        Names without `.npy`, in file order.

    Raises:
        UserError: there is no such file, or it is no .npz.
    """
    with _archive(path) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]


def array_shape(path: Path, key: str | None = None) -> tuple[int, ...]:
    """Read the shape of a stored array from its header alone.

    Args:
        path: a .npy or .npz.
        key: the array's name in an .npz; None for a .npy.

    Returns:
        Its shape, as NumPy has it.

    Raises:
        UserError: the file is missing or damaged, has no array `key`, or holds Python objects.
    """
    return _with_member(path, key, lambda file, size: _header(file, size, path, key)[0])


def read_array(path: Path, key: str | None = None, largest: int = LARGEST) -> NDArray[Any]:
    """Read one stored array; objects are never unpickled.

    Args:
        path: a .npy or .npz.
        key: the array's name in an .npz; None for a .npy.
        largest: most elements that are accepted.

    Returns:
        The array in its stored type. [...]

    Raises:
        UserError: the file is missing, damaged or ends early, has no array `key`, or the array is larger than `largest` or no
            array of numbers.
    """

    def read(file: IO[bytes], size: int) -> NDArray[Any]:
        shape, kind, fortran = _header(file, size, path, key, largest)
        count = int(np.prod(shape, dtype=np.int64))
        data = file.read(count * kind.itemsize)
        if len(data) != count * kind.itemsize:
            raise ValueError("the file ends early")
        flat = np.frombuffer(data, kind)
        return flat.reshape(shape[::-1]).T if fortran else flat.reshape(shape)

    return _with_member(path, key, read)


def read_arrays(path: Path, wanted: Callable[[str], bool], largest: int = 1 << 26) -> dict[str, NDArray[np.float64]]:
    """Read those arrays of an .npz that are asked for.

    Args:
        path: the .npz.
        wanted: says of an array's name whether to read it.
        largest: most elements of each that are accepted.

    Returns:
        Name to array [...], as float64.

    Raises:
        UserError: as `read_array`.
    """
    return {name: np.asarray(read_array(path, name, largest), float) for name in array_names(path) if wanted(name)}


def _archive(path: Path) -> zipfile.ZipFile:
    _whole(path)
    try:
        return zipfile.ZipFile(path)
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise UserError(path, f"cannot be read ({error})", AGAIN) from None


def _whole(path: Path) -> None:
    if not path.is_file():
        raise UserError(path, "is not a regular file" if path.exists() else "is not there", AGAIN)
    if path.stat().st_size == 0:
        raise UserError(path, "the file is empty (0 bytes)", AGAIN)


def _with_member(path: Path, key: str | None, read: Callable[[IO[bytes], int], Any]) -> Any:
    """What `read` makes of an array's file and its bytes."""
    try:
        if key is None:
            _whole(path)
            with path.open("rb") as file:
                return read(file, path.stat().st_size)
        with _archive(path) as archive:
            info = next((i for i in archive.infolist() if i.filename.lower() == f"{key.lower()}.npy"), None)
            if info is None:
                have = ", ".join(n.removesuffix(".npy") for n in archive.namelist()[:8])
                raise UserError(path, f"has no {key} (it has {have})", f"write {key} into it")
            with archive.open(info) as member:
                return read(member, info.file_size)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, NotImplementedError, RuntimeError, OverflowError) as error:
        raise UserError(
            path, f"cannot be read ({(str(error).splitlines() or [repr(error)])[0][:LONGEST_REASON]})", AGAIN
        ) from None
    except Exception as error:  # zlib's own, and what a damaged header makes of Python's parser
        if type(error).__module__ not in ("zlib", "builtins", "tokenize") or isinstance(error, UserError | MemoryError):
            raise
        raise UserError(path, f"cannot be read ({type(error).__name__})", AGAIN) from None


def _header(file: IO[bytes], size: int, path: Path, key: str | None, largest: int = LARGEST) -> Header:
    """Shape, type and order of an array; checked against the file's bytes. Raises ValueError, UserError."""
    version = np.lib.format.read_magic(file)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = reader(file)
    where = f"{key} " if key else ""
    if kind.kind not in "fiub" or kind.subdtype is not None:
        raise UserError(path, f"{where}holds {kind}, not numbers", "save an array of numbers")
    if any(n < 0 for n in shape):
        raise ValueError(f"an array of the shape {shape}")
    total = kind.itemsize
    for n in shape:
        total *= n
    if total > largest:
        raise UserError(path, f"{where}would be {total / 2**20:.0f} MB (its shape is {shape})", "is it the right file?")
    if total > size:
        raise ValueError("the file ends early")
    return tuple(shape), kind, fortran
