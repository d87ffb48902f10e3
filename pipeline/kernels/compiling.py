"""How every kernel here is compiled."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit


def _digest() -> str:
    root = Path(__file__).parents[2]
    sources = sorted([*root.glob("pipeline/kernels/*.py"), *root.glob("stages/train/rasterize/*.py")])
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


_STAMP = _digest()


def kernel(function: Callable[..., Any], *, allocates: bool = False) -> Any:
    """njit without the GIL, without Python's division checks, cached on disk.

    Unless it allocates, without reference counts too: an atomic count for every view of an array, shared by the threads,
    took two fifths of the backward pass.

    numba drops a cached kernel only when the kernel's own file changed, though constants and inlined helpers come from
    others: the stamp is over the folder instead.
    """
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": allocates}
    compiled: Any = njit(**options)(function)
    compiled._cache._cache_file._source_stamp = _STAMP
    return compiled


def allocating_kernel(function: Callable[..., Any]) -> Any:
    """A kernel that may make arrays."""
    return kernel(function, allocates=True)
