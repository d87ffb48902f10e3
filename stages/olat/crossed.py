"""Two lobes of one surface whose tangents cross within a pixel: shared normal and widths, two directions.

Brushed parts meet, hair crosses, a mesh's faces are smaller than a pixel: one anisotropic lobe fitted to such a pixel
is too round and points nowhere. Levenberg-Marquardt over (tilt 2, log sigma 2, angle 2, albedo 2).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.lights.lobes import jacobian, values
from pipeline.lights.numerics import FAST, ZERO, cholesky_solve, copy1, copy2
from stages.olat.specular import hold, tilt, weighted_square

SIZE = 8
SPREADS = (0.45, 0.8)  # half angle (rad) between the two tangents to start from
STEPS = 8
LOG_MIN, LOG_MAX = math.log(0.01), math.log(2.0)


@njit(cache=True, error_model="numpy")
def shape_of(s1, s2, angle, shape, slope):
    """A, B, C of widths (e^s1 along `angle`, e^s2 across), and `slope` [3, 3]: their derivatives by s1, s2, angle."""
    a, b = math.exp(-2 * s1), math.exp(-2 * s2)
    c, s = math.cos(angle), math.sin(angle)
    m0, m1 = a * c * c + b * s * s, (a - b) * c * s
    root = math.sqrt(m0)
    shape[0] = 0.5 * math.log(m0)
    shape[1] = -s1 - s2 - shape[0]
    shape[2] = m1 / root
    d0 = (-2 * a * c * c, -2 * b * s * s, 2 * c * s * (b - a))
    d1 = (-2 * a * c * s, 2 * b * c * s, (a - b) * (c * c - s * s))
    for k in range(3):
        slope[0, k] = 0.5 * d0[k] / m0
        slope[1, k] = -slope[0, k] - (1.0 if k < 2 else 0.0)
        slope[2, k] = d1[k] / root - shape[2] * slope[0, k]


@njit(cache=True, error_model="numpy")
def _system(lobe, frame, x, o, h, i, light, floor, weight, rows, one, prior, n_d, matrix, gradient):
    """Normal equations [8, 8] of the two lobes at x = (s1, s2, angle, angle, rho, rho); returns the cost."""
    shape, slope = np.empty(3), np.empty((3, 3))
    n = light.size
    for k in range(light.size):
        rows[0, k] = rows[1, k] = rows[2, k] = rows[3, k] = ZERO
    for lobe_index in range(2):
        rho = x[4 + lobe_index]
        shape_of(x[0], x[1], x[2 + lobe_index], shape, slope)
        jacobian(lobe, frame, shape, o, h, i, one)
        for k in range(n):
            rows[0, k] += rho * one[0, k]
            rows[1, k] += rho * one[1, k]
            rows[2, k] += rho * (one[2, k] * slope[0, 0] + one[3, k] * slope[1, 0] + one[4, k] * slope[2, 0])
            rows[3, k] += rho * (one[2, k] * slope[0, 1] + one[3, k] * slope[1, 1] + one[4, k] * slope[2, 1])
            rows[4 + lobe_index, k] = rho * (one[2, k] * slope[0, 2] + one[3, k] * slope[1, 2] + one[4, k] * slope[2, 2])
            rows[6 + lobe_index, k] = one[5, k]
    cost = 0.0
    for k in range(n):
        r = x[4] * rows[6, k] + x[5] * rows[7, k] - light[k]
        w = weight[k]
        if floor[k] > 0 and r > 0:
            w = ZERO
        one[0, k] = w
        one[1, k] = w * r
        cost += w * r * r
    for a in range(SIZE):
        gradient[a] = _dot(rows[a], one[1])
        for k in range(n):
            one[2, k] = rows[a, k] * one[0, k]
        for b in range(a, SIZE):
            matrix[a, b] = matrix[b, a] = _dot(one[2], rows[b])
    return cost + hold(frame, n_d, prior, matrix, gradient)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _dot(a, b):
    s = ZERO * a[0]
    for k in range(a.size):
        s += a[k] * b[k]
    return s


@njit(cache=True, error_model="numpy")
def optimise_crossed(lobe, frame, x, o, h, i, light, floor, weight, prior, n_d, steps, tolerance):
    """Levenberg-Marquardt in place on (frame, x). Returns (cost over the data's square norm, gradient norm, passes)."""
    n = light.size
    rows, one = np.zeros((SIZE, n), light.dtype), np.zeros((6, n), light.dtype)
    matrix, gradient = np.empty((SIZE, SIZE)), np.empty(SIZE)
    matrix2, gradient2 = np.empty((SIZE, SIZE)), np.empty(SIZE)
    system, step, x2, frame2 = np.empty((SIZE, SIZE)), np.empty(SIZE), np.empty(6), np.empty((3, 3))
    size = weighted_square(light, weight)
    if not size > 0:
        return 0.0, 0.0, 0
    cost = _system(lobe, frame, x, o, h, i, light, floor, weight, rows, one, prior, n_d, matrix, gradient)
    damping, passes, norm = 1e-3, 1, 0.0
    for _ in range(steps):
        norm = 0.0
        for k in range(SIZE):
            g = gradient[k] * (x[k - 2] if k >= 6 else 1.0)
            norm += g * g
        norm = math.sqrt(norm) / size
        if norm < tolerance:
            break
        for j in range(SIZE):
            for k in range(SIZE):
                system[j, k] = matrix[j, k]
            system[j, j] += damping * matrix[j, j] + 1e-9 * size
        if not cholesky_solve(system, gradient, SIZE, step):
            damping = max(10 * damping, 1e-3)
            continue
        limit = 0.0
        for k in range(6):
            limit = max(limit, abs(step[k]))
        scale = min(1.0, 0.4 / limit) if limit > 0 else 1.0
        tilt(frame, -scale * step[0], -scale * step[1], frame2)
        for k in range(6):
            x2[k] = x[k] - scale * step[k + 2]
        for k in range(2):
            x2[k] = min(max(x2[k], LOG_MIN), LOG_MAX)
            x2[4 + k] = max(x2[4 + k], 0.0)
        cost2 = _system(lobe, frame2, x2, o, h, i, light, floor, weight, rows, one, prior, n_d, matrix2, gradient2)
        passes += 1
        if cost2 < cost * (1 + 1e-6):
            copy2(frame2, frame)
            copy2(matrix2, matrix)
            copy1(x2, x)
            copy1(gradient2, gradient)
            cost = cost2
            damping = damping * 0.2 if damping > 1e-9 else 0.0
        else:
            damping = max(8 * damping, 1e-4)
            if damping > 1e6:
                break
    return cost / size, norm, passes


@njit(cache=True, error_model="numpy")
def crossed_values(lobe, frame, x, o, h, i, g):
    """Radiance per unit irradiance of the two lobes together, into `g` [N]."""
    shape, slope, second = np.empty(3), np.empty((3, 3)), np.empty_like(g)
    shape_of(x[0], x[1], x[2], shape, slope)
    values(lobe, frame, shape, o, h, i, g)
    shape_of(x[0], x[1], x[3], shape, slope)
    values(lobe, frame, shape, o, h, i, second)
    for k in range(g.size):
        g[k] = x[4] * g[k] + x[5] * second[k]


@njit(cache=True, error_model="numpy")
def fit_crossed(lobe, frame, x, large, small, angle, rho, o, h, i, light, floor, use, prior, n_d, tolerance):
    """Fit two crossed lobes from one (large, small, angle, rho), in place on (frame, x [6]). Returns (cost, passes)."""
    best, passes = 1e30, 0
    frame2, x2, start = np.empty((3, 3)), np.empty(6), np.empty((3, 3))
    copy2(frame, start)
    for spread in SPREADS:
        copy2(start, frame2)
        x2[0], x2[1] = math.log(large) + 0.15, math.log(small) - 0.3
        x2[2], x2[3] = angle - spread, angle + spread
        x2[4] = x2[5] = 0.5 * rho
        cost, _, more = optimise_crossed(lobe, frame2, x2, o, h, i, light, floor, use, prior, n_d, STEPS, tolerance)
        passes += more
        if cost < best:
            best = cost
            copy2(frame2, frame)
            copy1(x2, x)
    if x[1] > x[0]:  # the widths have changed places
        x[0], x[1] = x[1], x[0]
        x[2] += 0.5 * math.pi
        x[3] += 0.5 * math.pi
    return best, passes
