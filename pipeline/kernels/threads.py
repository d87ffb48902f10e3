"""Run one numba kernel on all cores: plain threads and nogil kernels that share a ticket counter.

numba's own thread layers are left alone: OpenMP's spinning workers fight torch's over the cores, and parallel=True
compiles several times longer.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np


@cache
def _helpers(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="rasterize")


def thread_count() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0))


def run_on_all_cores(kernel: Callable[..., None], *arguments: Any) -> None:
    """Call kernel(counters, *arguments) once per core.

    The calls share the work by drawing tickets from counters[0], and tell each other apart by one from counters[1].
    """
    counters = np.zeros(2, np.int64)
    helpers = thread_count() - 1
    futures = [_helpers(helpers).submit(kernel, counters, *arguments) for _ in range(helpers)]
    kernel(counters, *arguments)
    for future in futures:
        if not future.cancel():  # a helper that has not begun by now has nothing left to do
            future.result()


def row_buffers(size: int) -> np.ndarray:
    """Uninitialised float32 workspace of `size` or more for each core, on cache lines. [cores, size']"""
    line = 64 // 4
    size = -(-size // line) * line
    whole = np.empty(thread_count() * size + line, np.float32)
    skip = -(whole.ctypes.data // 4) % line
    return whole[skip : skip + thread_count() * size].reshape(thread_count(), size)
