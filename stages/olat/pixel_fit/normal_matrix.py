"""Quadratic forms of an inverse of normal equations: variances of what is fitted, and how far a fit is from its end."""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import cholesky_solve
from pipeline.kernels.scratch import matrix, vector

MOST = 12  # unknowns: as many as mixed tangents have
UNKNOWN = 1e12  # the form of a singular system: variance of what the samples do not tell


@kernel(error_model="numpy")
def inverse_form(system, right, n):
    """rightᵀ system⁻¹ right of the first n unknowns, solved at unit diagonal; `UNKNOWN` where the system is singular."""
    scale, work, out = vector(MOST), matrix(MOST, MOST), vector(MOST)
    for j in range(n):
        if not system[j, j] > 0:
            return UNKNOWN
        scale[j] = 1.0 / math.sqrt(system[j, j])
    for j in range(n):
        for k in range(n):
            work[j, k] = system[j, k] * scale[j] * scale[k]
    for j in range(n):
        scale[j] *= right[j]
    if not cholesky_solve(work, scale, n, out):
        return UNKNOWN
    total = 0.0
    for j in range(n):
        total += scale[j] * out[j]
    return total
