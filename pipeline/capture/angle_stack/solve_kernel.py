"""One linear solve per pixel: passes over a band of rows that fits the cache."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.kernels.compiling import kernel


@kernel(nogil=True, fastmath=True)
def apply_solver(samples: NDArray[np.float32], solver: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """out [P, 3, C] = solver [3, n] times samples [n, P, C], the same matrix everywhere."""
    n, pixels, colours = samples.shape
    flat = samples.reshape(n, pixels * colours)
    sums = np.empty((3, pixels * colours), np.float32)
    for s in range(3):
        for q in range(pixels * colours):
            sums[s, q] = solver[s, 0] * flat[0, q]
        for k in range(1, n):
            for q in range(pixels * colours):
                sums[s, q] += solver[s, k] * flat[k, q]
    for p in range(pixels):
        for s in range(3):
            for c in range(colours):
                out[p, s, c] = sums[s, p * colours + c]


@kernel(nogil=True)
def solve_patterns(
    samples: NDArray[np.float32],
    invalid: NDArray[np.bool_],
    solvers: NDArray[np.float32],
    determined: NDArray[np.bool_],
    out: NDArray[np.float32],
    lost: NDArray[np.bool_],
) -> None:
    """Solve again where samples [n, P, C] are `invalid` [n, P], without those: bit k of a pattern stands for angle k.

    solvers [2^n, 3, n] and whether they are `determined` [2^n]; where not, `lost` [P] is set and out [P, 3, C] stays.
    """
    n, pixels, colours = samples.shape
    for p in range(pixels):
        pattern = np.int64(0)
        for k in range(n):
            pattern |= np.int64(invalid[k, p]) << np.int64(k)
        if pattern == 0:
            continue
        if not determined[pattern]:
            lost[p] = True
            continue
        for s in range(3):
            for c in range(colours):
                total = np.float32(0)
                for k in range(n):
                    total += solvers[pattern, s, k] * samples[k, p, c]
                out[p, s, c] = total
