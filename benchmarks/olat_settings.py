"""What the olat benchmarks share: kernel settings as the stage has them by default, and a clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from stages.olat.pixel_fit.fit_options import FitOptions
from stages.olat.pixel_fit.result_layout import map_slices
from stages.olat.run import GAIN, MIXED, PRIOR

AT = map_slices()
SETTINGS = FitOptions(
    lobe=1, rounds=8, robust=2, steps=15, tolerance=3e-6, saturation=np.inf, specular_factor=2.0, irradiance=np.pi, gain=GAIN,
    mixed=MIXED, prior=PRIOR, plain=False, specular_fit=0, fuse_correlation=False, printed_maps=False, remove=False,
    gradient=False, one_pass=0, gap=0.1, removals=2,
)  # fmt: skip


def timed(work: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    """Median wall time and the result, after one run to compile."""
    work()
    times, out = [], None
    for _ in range(repeats):
        start = time.perf_counter()
        out = work()
        times.append(time.perf_counter() - start)
    return float(np.median(times)), out
