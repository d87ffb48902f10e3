"""Rows of the prefilter: integrals of a lobe over cube texels, from a pyramid of ever coarser cubes (numba)."""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel

GGX, BECKMANN, COSINE, TRANSMITTED = 0, 1, 2, 3
# IoR at which the transmitted irradiance level is computed (docs/physics.md).
REFERENCE_IOR = 1.5
# A pyramid texel is taken whole when its half diagonal is below this share of the lobe's local scale.
ACCEPT = 0.22
# The same for levels of few texels, whose rows can afford more: their lobes are wide and suns land anywhere in them.
ACCEPT_FEW = 0.12
FEW = 16
# Or when a sun anywhere in it changes the row's result by less than this share of itself.
TOLERANCE = 3e-4
# Texels of the finest level are sampled with nodes this far apart, in the same scale.
SAMPLE = 0.35
MAX_SAMPLES = 24
# Scale of the cosine kernels (and half of that of lobes so wide that their cosine matters): with ACCEPT, cells of
# 16^2 cubes pass.
COSINE_SCALE = 0.45
# A Beckmann lobe ends here: exp(-BECKMANN_REACH^2) = 1e-7 of its peak.
BECKMANN_REACH = 4.0


@kernel(fastmath=True, error_model="numpy")
def _lobe(kind, cosine, alpha):
    """Kernel at cos(angle to the axis): lobe D(h) (n.l) for a mirror direction equal to normal and view."""
    if cosine <= 0.0:
        return 0.0
    if kind >= COSINE:
        if kind == COSINE:
            return cosine
        e2 = REFERENCE_IOR * REFERENCE_IOR
        q = np.sqrt(e2 - 1.0 + cosine * cosine)
        a, b = cosine + q, e2 * cosine + q
        return cosine * 2.0 * cosine * q * (1.0 / (a * a) + e2 / (b * b))
    # tan^2 of half the angle
    t2 = max(0.0, 1.0 - cosine) / (1.0 + cosine)
    a2 = alpha * alpha
    nh2 = 1.0 / (1.0 + t2)
    if kind == GGX:
        k = (t2 + a2) * nh2
        return a2 / (k * k) * cosine
    return np.exp(-t2 / a2) / (nh2 * nh2) * cosine


@kernel(fastmath=True, error_model="numpy")
def _cell(kind, alpha, axis, axes, face, size, j, i, samples):
    """Integral of the kernel over cell (j, i) of a face with size^2 cells: midpoint rule, exact area element."""
    step = 2.0 / (size * samples)
    total = 0.0
    for b in range(samples):
        v = -1.0 + 2.0 * j / size + (b + 0.5) * step
        for a in range(samples):
            u = -1.0 + 2.0 * i / size + (a + 0.5) * step
            r2 = 1.0 + u * u + v * v
            r = np.sqrt(r2)
            dot = 0.0
            for k in range(3):
                dot += axis[k] * (axes[face, 0, k] + u * axes[face, 1, k] + v * axes[face, 2, k])
            total += _lobe(kind, dot / r, alpha) / (r2 * r)
    return total * step * step


@kernel(fastmath=True, error_model="numpy")
def _row(kind, alpha, accept, axis, axes, finest, levels, offsets, total, columns, values):
    """One row of weights that sum to `total`: descend from the coarsest cube, whole cells where the kernel is flat.

    Returns the number of entries; with empty `columns` it only counts them.
    """
    stack = np.empty((1024, 4), np.int32)
    top = 0
    coarsest = finest >> (levels - 1)
    reach = 0.5 * np.pi
    if kind == BECKMANN:
        reach = min(reach, 2.0 * np.arctan(BECKMANN_REACH * alpha))
    count, have = 0, 0.0
    norm = 4.0 * np.pi  # of D(h) (n.l) over l, but for the cosine at the horizon
    if kind == BECKMANN:
        norm *= alpha * alpha
    for root in range(6 * coarsest * coarsest):
        stack[0, 0] = levels - 1
        stack[0, 1] = root // (coarsest * coarsest)
        stack[0, 2] = root // coarsest % coarsest
        stack[0, 3] = root % coarsest
        top = 1
        while top > 0:
            top -= 1
            level, face, j, i = stack[top]
            size = finest >> level
            u = (2.0 * i + 1.0) / size - 1.0
            v = (2.0 * j + 1.0) / size - 1.0
            r = np.sqrt(1.0 + u * u + v * v)
            dot = 0.0
            for k in range(3):
                dot += axis[k] * (axes[face, 0, k] + u * axes[face, 1, k] + v * axes[face, 2, k])
            angle = np.arccos(min(1.0, max(-1.0, dot / r)))
            half = 1.4143 / (size * r)
            if angle - half > reach:
                continue
            if kind >= COSINE:
                scale = COSINE_SCALE
            elif kind == BECKMANN:
                scale = min(2.0 * COSINE_SCALE, 2.0 * alpha)
            else:
                scale = min(2.0 * COSINE_SCALE, np.sqrt(angle * angle + 4.0 * alpha * alpha))
            split = level > 0 and half > accept * scale
            if split and kind < COSINE and angle > 2.0 * half:
                # Far from the peak: how much the cell holds, times how much the kernel varies over it.
                held = _lobe(kind, dot / r, alpha) / norm * 4.0 / (size * size * r * r * r)
                split = held * min(1.0, half / scale) > TOLERANCE
            if split:
                for child in range(4):
                    stack[top, 0] = level - 1
                    stack[top, 1] = face
                    stack[top, 2] = 2 * j + child // 2
                    stack[top, 3] = 2 * i + child % 2
                    top += 1
                continue
            if columns.size > 0:
                samples = min(MAX_SAMPLES, max(2, int(np.ceil(half / (SAMPLE * scale)))))
                values[count] = _cell(kind, alpha, axis, axes, face, size, j, i, samples)
                columns[count] = offsets[level] + (face * size + j) * size + i
                have += values[count]
            count += 1
    for k in range(min(count, columns.size)):
        values[k] *= total / have
    return count


@kernel(parallel=True)
def count_rows(kind, alpha, accept, directions, axes, finest, levels, offsets):
    """Entries in the row of each direction [n, 3]."""
    counts = np.empty(len(directions), np.int64)
    for row in prange(len(directions)):
        counts[row] = _row(
            kind, alpha, accept, directions[row], axes, finest, levels, offsets, 1.0,
            np.empty(0, np.int32), np.empty(0, np.float64),
        )  # fmt: skip
    return counts


@kernel(parallel=True)
def fill_rows(kind, alpha, accept, directions, axes, finest, levels, offsets, total, starts, columns, values):
    """Fill CSR `columns` and `values` of the rows that begin at `starts` [n + 1]."""
    for row in prange(len(directions)):
        a, b = starts[row], starts[row + 1]
        _row(kind, alpha, accept, directions[row], axes, finest, levels, offsets, total, columns[a:b], values[a:b])
