"""Lookups in the tables of many anchors at once, blended point by point (numba, float32, CPU).

The readable definitions are `gridmap.plain_weights` and `gridmap.plain_blend`; tests hold these to them.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel

from .shade_kernels import MATH, texels

_ONE, _ZERO = np.float32(1), np.float32(0)


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def blend_weights(points, anchors, printed, floor, out):
    """Weights [P, A] of anchors [A, 3] at points [P, 3], summing to 1: distance if `printed`, else 1 / (distance^2 + floor)."""
    for p in prange(len(points)):
        total = _ZERO
        for a in range(len(anchors)):
            x, y, z = points[p, 0] - anchors[a, 0], points[p, 1] - anchors[a, 1], points[p, 2] - anchors[a, 2]
            square = x * x + y * y + z * z
            out[p, a] = np.sqrt(square) if printed else _ONE / (square + floor)
            total += out[p, a]
        for a in range(len(anchors)):
            out[p, a] /= total


@kernel(fastmath=MATH, error_model="numpy")
def _mean(tables, row, weight, p):
    """RGB of a texel, blended over the anchors."""
    red, green, blue = _ZERO, _ZERO, _ZERO
    for a in range(tables.shape[1]):
        w = weight[p, a]
        red += w * tables[row, a, 0]
        green += w * tables[row, a, 1]
        blue += w * tables[row, a, 2]
    return red, green, blue


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def add_blended(tables, start, size, index, directions, rows, share, weight, out):
    """out[p] += share[p] x the anchors' bilinear lookups in directions[p], blended by weight[p], for the points p of `rows`.

    tables [T, A, 3]: the anchors' packed levels, a texel's side by side; start, size: the level's; index: its padded rows.
    """
    for k in prange(len(rows)):
        p = rows[k]
        where = texels(directions[p, 0], directions[p, 1], directions[p, 2], size, index, 0)
        s, t = where[4], where[5]
        a, b = _mean(tables, start + where[6], weight, p), _mean(tables, start + where[7], weight, p)
        c, d = _mean(tables, start + where[8], weight, p), _mean(tables, start + where[9], weight, p)
        for channel in range(3):
            top = a[channel] + (b[channel] - a[channel]) * s
            bottom = c[channel] + (d[channel] - c[channel]) * s
            out[p, channel] += share[p] * (top + (bottom - top) * t)
