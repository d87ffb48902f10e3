"""Lookups in the tables of many anchors at once, blended point by point (numba, float32, CPU).

The readable definitions are `gridmap.plain_weights` and `gridmap.plain_blend`; tests hold these to them.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel

from .cube_kernels import MATH, texels

_ONE, _ZERO = np.float32(1), np.float32(0)


@kernel(fastmath=MATH, error_model="numpy")
def blend_weights(points, anchors, printed, floor, out):
    """Weights [P, A] of anchors [3, A] at points [P, 3], summing to 1: distance if `printed`, else 1 / (distance^2 + floor).

    On one thread: numba does not vectorise the inner loops of a parallel one, which took 45 times as long.
    """
    count = anchors.shape[1]
    for p in range(len(points)):
        px, py, pz = points[p, 0], points[p, 1], points[p, 2]
        total = _ZERO
        if printed:
            for a in range(count):
                x, y, z = px - anchors[0, a], py - anchors[1, a], pz - anchors[2, a]
                w = np.sqrt(x * x + y * y + z * z)
                out[p, a] = w
                total += w
        else:
            for a in range(count):
                x, y, z = px - anchors[0, a], py - anchors[1, a], pz - anchors[2, a]
                w = _ONE / (x * x + y * y + z * z + floor)
                out[p, a] = w
                total += w
        scale = _ONE / total
        for a in range(count):
            out[p, a] *= scale


@kernel(fastmath=MATH, error_model="numpy")
def _mean(tables, row, weight, p):
    """RGB of a texel, blended over the anchors."""
    red, green, blue = _ZERO, _ZERO, _ZERO
    for a in range(tables.shape[2]):
        w = weight[p, a]
        red += w * tables[row, 0, a]
        green += w * tables[row, 1, a]
        blue += w * tables[row, 2, a]
    return red, green, blue


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def add_blended(tables, start, size, index, directions, rows, share, weight, out):
    """out[p] += share[p] x the anchors' bilinear lookups in directions[p], blended by weight[p], for the points p of `rows`.

    tables [T, 3, A]: the anchors' packed levels, a texel's side by side; start, size: the level's; index: its padded rows.
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
