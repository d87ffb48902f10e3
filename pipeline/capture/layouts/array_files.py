"""NumPy arrays as images: what SMVP3D and RMVP3D share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.arrays import array_shape, read_array


def array_size(path: Path, key: str | None = None) -> tuple[int, int]:
    """(width, height) of an array [H, W(, 3)] in a .npy, or under `key` in a .npz, from its header. Raises UserError."""
    shape = array_shape(path, key)
    _check(path, shape)
    return shape[1], shape[0]


def load_array(path: Path, key: str | None = None) -> NDArray[np.float32]:
    """An array [H, W, 3] float32 (a grey one repeated). Raises UserError naming file and fault."""
    _check(path, array_shape(path, key))
    array = np.asarray(read_array(path, key), np.float32)
    return np.repeat(array[..., None], 3, axis=-1) if array.ndim == 2 else np.ascontiguousarray(array)


def _check(path: Path, shape: tuple[int, ...]) -> None:
    if len(shape) not in (2, 3) or shape[2:] not in ((), (3,)) or 0 in shape:
        raise UserError(path, f"holds an array of shape {shape}", "expected (height, width, 3)")
