"""Memory of whole frames, used again: touching 430 MB for the first time costs more than converting them."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

SMALL = 1 << 24
"""Bytes below which the allocator recycles by itself."""
KEPT = 4
"""Free blocks kept at most: samples and result of each of two frames under way."""
_free: deque[NDArray[np.uint8]] = deque()


class _Lease:
    """Owns one block while any array on it lives; numpy keeps it as the array's base."""

    def __init__(self, block: NDArray[np.uint8], size: int) -> None:
        self._block = block
        self.__array_interface__: dict[str, Any] = {**block.__array_interface__, "shape": (size,)}

    def __del__(self, free: deque[NDArray[np.uint8]] = _free) -> None:  # bound here: at exit a module's names may be gone
        free.append(self._block)
        if len(free) > KEPT:
            free.popleft()


def frame_array(shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> NDArray[Any]:
    """An array like np.empty(shape, dtype), on memory of a frame that is no longer in use where there is some."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < SMALL:
        return np.empty(shape, dtype)
    block = _taken(size)
    return np.asarray(_Lease(np.empty(size, np.uint8) if block is None else block, size)).view(dtype).reshape(shape)


def _taken(size: int) -> NDArray[np.uint8] | None:
    """A free block of about this size, or None."""
    for _ in range(len(_free)):
        try:
            block = _free.popleft()
        except IndexError:  # another thread took the last one
            return None
        if size <= len(block) <= 2 * size:
            return block
        _free.append(block)
    return None
