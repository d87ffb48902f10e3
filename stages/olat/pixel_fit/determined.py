"""How well the lights tell a fitted lobe: standard deviations by its normal equations, and how near a light comes to its peak.

A fit always ends somewhere. Where the samples see only a lobe's flank, or fewer of it than it has parameters, they are matched
by many lobes, and the one that is found is chance: widths and albedo then have variances that say so.
"""

from __future__ import annotations

import math

from numba import njit

from pipeline.kernels.numerics import FAST, ZERO
from pipeline.kernels.scratch import matrix, vector
from pipeline.rig.lobes import normal_equations

SURE = 0.15
"""Standard deviation of the log of a width or of the albedo up to which a lobe counts as told: half of a value (0.4 in the log)
is then 2.7 of them away."""
NEAREST = 1.2
"""Widths between the lobe's peak and the nearest half vector that a light shows: a Gaussian has fallen to 0.24 there, and what
is said of the peak is more extrapolated than seen."""
GRAIN = 1e-3
"""Of the brightest sample: the standard deviation that half floats and the lobe's own form leave at best."""
UNTOLD = 1e6  # standard deviation of what the samples do not tell


@njit(cache=True, fastmath=FAST, error_model="numpy")
def strong(light, use, level):
    """Sum and sum of squares of the samples above `level`: noise, which lies below it, is no light."""
    whole = squares = ZERO * level
    for k in range(light.size):
        v, u = light[k], use[k]
        v = v if (u > ZERO) & (v > level) else ZERO
        whole += v
        squares += v * v
    return float(whole), float(squares)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _nearest(hx, hy, hz, use, tx, ty, tz, bx, by, bz, nx, ny, nz, a, b):
    """Least square distance, in widths 1/a along t and 1/b along b, of a light's half vector from the normal (in slopes)."""
    least = ZERO * a + 1e30
    for k in range(hx.size):
        z = nx * hx[k] + ny * hy[k] + nz * hz[k]
        u = a * (tx * hx[k] + ty * hy[k] + tz * hz[k])
        v = b * (bx * hx[k] + by * hy[k] + bz * hz[k])
        r = (u * u + v * v) / (z * z)
        least = min(least, r if (use[k] > ZERO) & (z > ZERO) else least)
    return least


@njit(cache=True, error_model="numpy")
def nearest(half, use, frame, large, small):
    """Distance, in widths, of the half vector nearest to the peak of a lobe in `frame` (t along the larger width)."""
    k = half[0].dtype.type
    t, b, n = frame[0], frame[1], frame[2]
    return math.sqrt(_nearest(half[0], half[1], half[2], use, k(t[0]), k(t[1]), k(t[2]), k(b[0]), k(b[1]), k(b[2]),
                              k(n[0]), k(n[1]), k(n[2]), k(1.0 / large), k(1.0 / small)))  # fmt: skip


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _noise(g, rho, light, floor, weight):
    square = count = ZERO * rho
    for k in range(g.size):
        r = rho * g[k] - light[k]
        w = weight[k] if floor[k] == ZERO else ZERO
        square += w * r * r
        count += w
    return float(square), float(count)


@njit(cache=True, error_model="numpy")
def deviation(lobe, frame, large, small, rho, o, half, incident, light, floor, weight, g, round_lobe, fixed, top):
    """Largest standard deviation of log widths and log albedo, `UNTOLD` where the samples leave one of them free.

    frame [3, 3]: rows t (along the larger width), b, n; round_lobe: the widths are one parameter; fixed: the normal is
    given, else only the samples tell it; top: brightest sample. See `specular.optimise` for the rest.
    """
    shape, gradient, equations = vector(3), vector(6), matrix(6, 6)
    shape[0], shape[1], shape[2] = -math.log(large), -math.log(small), 0.0
    normal_equations(lobe, frame, shape, rho, o, half, incident, light, floor, weight, equations, gradient)
    n = 4 if round_lobe else 6
    square, count = _noise(g, light.dtype.type(rho), light, floor, weight)
    variance = max(square / max(count - n, 1.0), (GRAIN * top) ** 2)
    if round_lobe:
        for k in range(6):
            equations[2, k] += equations[3, k]
        for k in range(6):
            equations[k, 2] += equations[k, 3]
            equations[k, 3] = equations[k, 5]
        for k in range(4):
            equations[3, k] = equations[5, k]
        equations[3, 3] = equations[5, 5]
    for k in range(n):
        equations[k, n - 1] *= rho
        equations[n - 1, k] *= rho
    if fixed:
        for k in range(n):
            for j in range(2):
                equations[j, k] = equations[k, j] = 0.0
    worst = 0.0
    for j in range(2, n):
        if round_lobe or j != 4:  # the direction of the tangent is another matter
            worst = max(worst, _variance_of(equations, n, j))
    return min(math.sqrt(worst * variance), UNTOLD) if worst >= 0 else UNTOLD


@njit(cache=True, error_model="numpy")
def _variance_of(equations, n, j):
    """Entry (j, j) of the inverse of the symmetric matrix [n, n]: 1 over the pivot that j has when it is eliminated last."""
    work = matrix(6, 6)
    for r in range(n):
        for c in range(n):
            work[r, c] = equations[r, c]
    for p in range(n):
        if p == j:
            continue
        pivot = work[p, p]
        if not pivot > 1e-12 * equations[p, p]:
            continue  # nothing is known of p: it says nothing of j either, unless it shares its samples, which this leaves out
        for r in range(n):
            if r != p:
                f = work[r, p] / pivot
                for c in range(n):
                    work[r, c] -= f * work[p, c]
    rest = work[j, j]
    return 1.0 / rest if rest > 1e-10 * equations[j, j] and equations[j, j] > 0 else 1e30
