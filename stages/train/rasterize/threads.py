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
    """Call kernel(counter, *arguments) once per core; the calls share the work by drawing tickets from counter int64[1]."""
    counter = np.zeros(1, np.int64)
    helpers = thread_count() - 1
    futures = [_helpers(helpers).submit(kernel, counter, *arguments) for _ in range(helpers)]
    kernel(counter, *arguments)
    for future in futures:
        future.result()
