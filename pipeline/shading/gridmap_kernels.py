"""Lookups in the tables of many anchors at once, blended point by point (numba, float32, CPU).

The readable definitions are `gridmap.plain_weights` and `gridmap.plain_blend`; tests hold these to them. Anchors lie side by
side, filled up to whole `LANES` with tables of 0, so that a texel of all of them is a few registers. Weights are not normalised
before they are used: their total is summed beside the light.
"""

from __future__ import annotations

import numpy as np

from pipeline.geometry.frame_kernel import frame_across
from pipeline.kernels.compiling import kernel
from pipeline.kernels.simd import LANES, load, spread, store, store_totals, take_ticket

from .cube_kernels import MATH, texels
from .shade_kernels import level_below

CHUNK = 256  # points that a thread takes at a time
TOTALS = 4  # floats of workspace beside the weights: red, green, blue, and of the weights themselves
_ONE, _ZERO = np.float32(1), np.float32(0)


@kernel(nogil=True, fastmath=MATH, error_model="numpy")
def _weigh(x, y, z, anchors, count, printed, floor, weight):
    """The weights of `count` anchors [3, A] at a point: distance if `printed`, else 1 / (distance^2 + floor); 0 beyond them."""
    width = anchors.shape[1]
    for a in range(0, width, LANES):
        dx, dy, dz = load(anchors, a) - x, load(anchors, width + a) - y, load(anchors, 2 * width + a) - z
        square = dx * dx + dy * dy + dz * dz
        store(weight, a, square if printed else _ONE / (square + floor))
    if printed:
        for a in range(count):
            weight[a] = np.sqrt(weight[a])
    for a in range(count, width):
        weight[a] = _ZERO


@kernel(nogil=True, fastmath=MATH, error_model="numpy")
def _blend(tables, start, where, weight):
    """Mean light (r, g, b) of the anchors' tables [T, 3, A] by weight, at the place `where` (`texels`) of the level at `start`.

    Totals are left in weight [A + TOTALS], behind the weights.
    """
    width = tables.shape[2]
    s, t = where[4], where[5]
    share0, share1, share2, share3 = (_ONE - s) * (_ONE - t), s * (_ONE - t), (_ONE - s) * t, s * t
    row0, row1 = 3 * width * np.int64(start + where[6]), 3 * width * np.int64(start + where[7])
    row2, row3 = 3 * width * np.int64(start + where[8]), 3 * width * np.int64(start + where[9])
    red, green, blue, total = spread(_ZERO), spread(_ZERO), spread(_ZERO), spread(_ZERO)
    for a in range(0, width, LANES):
        w = load(weight, a)
        w0, w1, w2, w3 = w * share0, w * share1, w * share2, w * share3
        i, j, k, m = row0 + a, row1 + a, row2 + a, row3 + a
        red += w0 * load(tables, i) + w1 * load(tables, j) + w2 * load(tables, k) + w3 * load(tables, m)
        i, j, k, m = i + width, j + width, k + width, m + width
        green += w0 * load(tables, i) + w1 * load(tables, j) + w2 * load(tables, k) + w3 * load(tables, m)
        i, j, k, m = i + width, j + width, k + width, m + width
        blue += w0 * load(tables, i) + w1 * load(tables, j) + w2 * load(tables, k) + w3 * load(tables, m)
        total += w
    store_totals(weight, width, red, green, blue, total)
    scale = _ONE / weight[width + 3]
    return weight[width] * scale, weight[width + 1] * scale, weight[width + 2] * scale


@kernel(nogil=True, fastmath=MATH, error_model="numpy")
def receive(
    counters, points, normals, anchors, count, printed, floor, tables, start, size, index, tilt, workspace, out, slope
):  # fmt: skip
    """Fill the blended lookups of a level out [P, 3] at points [P, 3] in the directions `normals` [P, 3].

    start, size, index: the level's first row, resolution and padded rows. slope [P, 3, 3], or empty: change of the light with
    the direction, across it: the differences to directions tilted by `tilt` along two axes.
    """
    weight = workspace[take_ticket(counters, 1)]
    while True:
        first = take_ticket(counters, 0) * CHUNK
        if first >= len(points):
            return
        for p in range(first, min(first + CHUNK, len(points))):
            _weigh(points[p, 0], points[p, 1], points[p, 2], anchors, count, printed, floor, weight)
            x, y, z = normals[p, 0], normals[p, 1], normals[p, 2]
            here = _blend(tables, start, texels(x, y, z, size, index, 0), weight)
            out[p, 0], out[p, 1], out[p, 2] = here
            if len(slope) == 0:
                continue
            ux, uy, uz, vx, vy, vz = frame_across(x, y, z)
            u = _blend(tables, start, texels(x + tilt * ux, y + tilt * uy, z + tilt * uz, size, index, 0), weight)
            v = _blend(tables, start, texels(x + tilt * vx, y + tilt * vy, z + tilt * vz, size, index, 0), weight)
            for c in range(3):
                along, other = (u[c] - here[c]) / tilt, (v[c] - here[c]) / tilt
                slope[p, 0, c] = ux * along + vx * other
                slope[p, 1, c] = uy * along + vy * other
                slope[p, 2, c] = uz * along + vz * other


@kernel(nogil=True, fastmath=MATH, error_model="numpy")
def reflect(
    counters, points, directions, roughness, rows, anchors, count, printed, floor, tables, nodes, sizes, starts, index, bases,
    workspace, out,
):  # fmt: skip
    """Fill the blended mirrored light out [P, 3] of the points `rows` [K], in directions [P, 3] and of roughness [P]; the rest
    as `LightField.tables`."""
    weight = workspace[take_ticket(counters, 1)]
    while True:
        first = take_ticket(counters, 0) * CHUNK
        if first >= len(rows):
            return
        for k in range(first, min(first + CHUNK, len(rows))):
            p = rows[k]
            _weigh(points[p, 0], points[p, 1], points[p, 2], anchors, count, printed, floor, weight)
            x, y, z = directions[p, 0], directions[p, 1], directions[p, 2]
            level, fraction, _ = level_below(roughness[p], nodes)
            fraction = min(max(fraction, _ZERO), _ONE)
            below = _blend(tables, starts[level], texels(x, y, z, sizes[level], index, bases[level]), weight)
            above = _blend(tables, starts[level + 1], texels(x, y, z, sizes[level + 1], index, bases[level + 1]), weight)
            for c in range(3):
                out[p, c] = below[c] + (above[c] - below[c]) * fraction
