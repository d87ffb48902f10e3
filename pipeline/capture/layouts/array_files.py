"""NumPy arrays as images: what SMVP3D and RMVP3D share."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError


def array_size(path: Path, key: str | None = None) -> tuple[int, int]:
    """(width, height) of an array [H, W(, 3)] in a .npy, or under `key` in a .npz; from the header where that is enough."""
    if key is None:
        try:
            shape = np.load(path, mmap_mode="r").shape
        except (OSError, ValueError, EOFError) as error:
            raise _unreadable(path, error) from None
    else:
        shape = load_array(path, key).shape
    if len(shape) not in (2, 3):
        raise UserError(path, f"holds an array of shape {shape}", "expected (height, width, 3)")
    return int(shape[1]), int(shape[0])


def load_array(path: Path, key: str | None = None) -> NDArray[np.float32]:
    """An array [H, W, 3] float32 (a grey one repeated). Raises UserError naming file and fault."""
    try:
        loaded = np.load(path)
        if key is None:
            array = loaded
        else:
            names: Mapping[str, str] = {name.lower(): name for name in loaded.files}
            if key.lower() not in names:
                raise UserError(path, f"has no {key} (it has {', '.join(loaded.files)})", "export S0, S1 and S2")
            array = loaded[names[key.lower()]]
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise _unreadable(path, error) from None
    array = np.asarray(array, np.float32)
    if array.ndim == 2:
        array = np.repeat(array[..., None], 3, axis=-1)
    if array.ndim != 3 or array.shape[2] != 3:
        raise UserError(path, f"holds an array of shape {array.shape}", "expected (height, width, 3)")
    return array


def _unreadable(path: Path, error: Exception) -> UserError:
    if path.is_file() and path.stat().st_size == 0:
        return UserError(path, "the file is empty (0 bytes)", "copy it again from its source")
    return UserError(path, f"cannot be read ({error})", "copy it again from its source")
