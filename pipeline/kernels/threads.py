"""Run one numba kernel on all cores: plain threads and nogil kernels that share a ticket counter.

numba's own thread layers are left alone: OpenMP's spinning workers fight torch's over the cores, and parallel=True
compiles several times longer.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np

from pipeline.cores import usable_cores


@cache
def _helpers(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="rasterize")


def thread_count() -> int:
    """Cores this process may use."""
    return usable_cores()


def run_on_all_cores(kernel: Callable[..., None], *arguments: Any) -> None:
    """Call a kernel once per core and wait for all calls.

    The calls share the work by drawing tickets from counters[0], and tell each other apart by one from counters[1].

    Args:
        kernel: nogil; its first argument is the counters, int64, zero at the start. [2]
        arguments: the others.
    """
    counters = np.zeros(2, np.int64)
    helpers = thread_count() - 1
    futures = [_helpers(helpers).submit(kernel, counters, *arguments) for _ in range(helpers)]
    kernel(counters, *arguments)
    for future in futures:
        if not future.cancel():  # a helper that has not begun by now has nothing left to do
            future.result()


def row_buffers(size: int) -> np.ndarray:
    """Make uninitialised workspace for each core, each beginning on a cache line.

    Args:
        size: least number of floats.

    Returns:
        float32. [cores, size or somewhat more]
    """
    line = 64 // 4
    size = -(-size // line) * line
    whole = np.empty(thread_count() * size + line, np.float32)
    skip = -(whole.ctypes.data // 4) % line
    return whole[skip : skip + thread_count() * size].reshape(thread_count(), size)
