"""One linear solve per pixel, the same matrix everywhere: a single pass over the samples."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(nogil=True, cache=True, fastmath=True)
def apply_solver(samples: NDArray[np.float32], solver: NDArray[np.float32]) -> NDArray[np.float32]:
    """(s0, s1, s2) [P, 3, C] = solver [3, n] times samples [n, P, C]."""
    n, pixels, colours = samples.shape
    out = np.zeros((pixels, 3, colours), np.float32)
    for p in range(pixels):
        for k in range(n):
            for c in range(colours):
                value = samples[k, p, c]
                out[p, 0, c] += solver[0, k] * value
                out[p, 1, c] += solver[1, k] * value
                out[p, 2, c] += solver[2, k] * value
    return out
