"""How fast one core of this machine is beside the one that the stages' figures were found on."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from pipeline.cores import usable_cores

REPEATS = 7
REFERENCE_S = {"interpreter": 0.0029, "arrays": 0.0026}
"""Seconds of each task on the reference machine: the least of many runs on a quiet core."""


@cache
def slowness() -> float:
    """Seconds that one core takes here for what takes one second on the reference machine; found in a tenth of a second."""
    ratios = [_least(task) / REFERENCE_S[name] for name, task in (("interpreter", _interpreter), ("arrays", _arrays))]
    return float(np.sqrt(ratios[0] * ratios[1]))


@cache
def machine() -> str:
    """A name for this machine's processor and how many of its cores this process may use."""
    model = platform.machine() or "unknown processor"
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    return f"{model} x {cores()}"


def cores() -> int:
    """Cores that this process may use."""
    return usable_cores()


def _least(task: Callable[[], object]) -> float:
    """The least of several runs, in seconds of this thread: others on the core lengthen some of them only."""
    found = []
    for _ in range(REPEATS):
        started = time.thread_time()
        task()
        found.append(time.thread_time() - started)
    return min(found)


def _interpreter() -> int:
    total = 0
    for k in range(100_000):
        total += k % 7
    return total


def _arrays() -> float:
    x = np.linspace(0.1, 1.0, 200_000)
    return float(np.sort(np.exp(-x) * np.sqrt(x))[::7].sum())
