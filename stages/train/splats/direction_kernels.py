"""Numba kernels over cells of space that remember in which directions rays have met something."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

from ..octahedral_map import octahedral_texel
from .splat_kernels import MATH

BINS = 8  # a side of the square that directions are sorted into: its 64 cells are the bits of a number


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def _bit(x, y, z):
    """The bit of a direction: its texel of an octahedral map."""
    j, i = octahedral_texel(x, z, y, BINS)
    return np.uint64(1) << np.uint64(BINS * i + j)


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def _cell(points, p, low, scale, shape):
    """Indices of the cell that point p lies in, or the nearest one."""
    i = min(max(int((points[p, 0] - low[0]) * scale), 0), shape[0] - 1)
    j = min(max(int((points[p, 1] - low[1]) * scale), 0), shape[1] - 1)
    k = min(max(int((points[p, 2] - low[2]) * scale), 0), shape[2] - 1)
    return i, j, k


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def mark(points, directions, met, low, scale, cells):
    """Set in cells [X, Y, Z] the bits of the rays that met something: met [P, K], from points [P, 3] along [P, K, 3]."""
    for p in range(len(points)):
        i, j, k = _cell(points, p, low, scale, cells.shape)
        for r in range(met.shape[1]):
            if met[p, r]:
                cells[i, j, k] |= _bit(directions[p, r, 0], directions[p, r, 1], directions[p, r, 2])


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def doubtful(points, directions, low, scale, cells, rows, rays):
    """List the rays from points [P, 3] along [P, K, 3] whose bit is set where they begin; returns how many, M.

    Filled up to M: rows [P K], which they are, and rays [P K, 6], points and directions.
    """
    count, each = 0, directions.shape[1]
    for p in range(len(points)):
        i, j, k = _cell(points, p, low, scale, cells.shape)
        seen = cells[i, j, k]
        if seen == 0:
            continue
        for r in range(each):
            x, y, z = directions[p, r, 0], directions[p, r, 1], directions[p, r, 2]
            if seen & _bit(x, y, z):
                rows[count] = each * p + r
                rays[count, 0], rays[count, 1], rays[count, 2] = points[p, 0], points[p, 1], points[p, 2]
                rays[count, 3], rays[count, 4], rays[count, 5] = x, y, z
                count += 1
    return count
