"""Lobes of one surface whose tangents mix within a pixel: shared normal and widths, a share of the light for each direction.

Brushed parts meet, hair crosses, a mesh's faces are smaller than a pixel: one anisotropic lobe fitted to such a pixel is too
round and points nowhere. In slope space the mixture's radial profile depends on the two widths alone, whatever the directions:
that is what keeps the widths apart. Levenberg-Marquardt over (tilt 2, log sigma 2, weights >= 0 of fixed directions).
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.kernels import scratch
from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, ZERO, cholesky_solve, copy1, copy2
from pipeline.rig.lobe_names import GGX
from pipeline.rig.lobes import jacobian, values
from stages.olat.pixel_fit.specular import hold, reweight, tilt, weighted_square

DIRECTIONS = 8  # 22.5 degrees apart: a quarter more than needed to tell widths of 3 to 1 (6 were measured to do)
SIZE = 4 + DIRECTIONS
LENGTH = 3 + DIRECTIONS  # numbers that describe a mixture: log widths, first angle, weights
STEPS = 12
ROUNDS = 2
REACH = 3.2  # widths of one lobe: beyond it the mixture is under 4e-5 of its peak
TAIL = 30.0  # the same of GGX, which falls by the fourth power alone: 1e-6 of its peak
LOG_MIN, LOG_MAX = math.log(0.01), math.log(2.0)


@kernel(error_model="numpy")
def shape_of(s1, s2, angle, shape, slope):
    """A, B, C of widths (e^s1 along `angle`, e^s2 across), and `slope` [2, 3]: their derivatives by s1, s2."""
    a, b = math.exp(-2 * s1), math.exp(-2 * s2)
    c, s = math.cos(angle), math.sin(angle)
    m0, m1 = a * c * c + b * s * s, (a - b) * c * s
    root = math.sqrt(m0)
    shape[0] = 0.5 * math.log(m0)
    shape[1] = -s1 - s2 - shape[0]
    shape[2] = m1 / root
    d0 = (-2 * a * c * c, -2 * b * s * s)
    d1 = (-2 * a * c * s, 2 * b * c * s)
    for k in range(2):
        slope[k, 0] = 0.5 * d0[k] / m0
        slope[k, 1] = -slope[k, 0] - 1.0
        slope[k, 2] = d1[k] / root - shape[2] * slope[k, 0]


@kernel(error_model="numpy")
def direction(x, j):
    """Angle (rad, from t) of the mixture's j-th direction."""
    return x[2] + j * (math.pi / DIRECTIONS)


@kernel(error_model="numpy")
def mixed_equations(lobe, frame, x, o, h, i, light, floor, weight, rows, one, prior, n_d, matrix, gradient):
    """Normal equations [SIZE, SIZE] of the mixture at x = (s1, s2, first angle, weights); returns the cost."""
    shape, slope = scratch.vector(3), scratch.matrix(2, 3)
    kind = light.dtype.type
    rows[:4] = ZERO
    for j in range(DIRECTIONS):
        shape_of(x[0], x[1], direction(x, j), shape, slope)
        if x[3 + j] > 0:
            jacobian(lobe, frame, shape, o, h, i, one)
            _add(one, kind(x[3 + j]), slope, rows)
            copy1(one[5], rows[4 + j])
        else:
            values(lobe, frame, shape, o, h, i, rows[4 + j])
    one[1] = ZERO
    for j in range(DIRECTIONS):
        if x[3 + j] > 0:
            _add_scaled(rows[4 + j], kind(x[3 + j]), one[1])
    cost = _residuals(light, floor, weight, one[1], one[0])
    for a in range(SIZE):
        gradient[a] = _dot(rows[a], one[1])
        _times(rows[a], one[0], one[2])
        for b in range(a, SIZE):
            matrix[a, b] = matrix[b, a] = _dot(one[2], rows[b])
    return cost + hold(frame, n_d, prior, matrix, gradient)


@kernel(fastmath=FAST, error_model="numpy")
def _add(one, rho, slope, rows):
    """Add `rho` x the derivatives of one lobe by tilt and log widths to the first four rows."""
    kind = one.dtype.type
    a0, a1, a2 = rho * kind(slope[0, 0]), rho * kind(slope[0, 1]), rho * kind(slope[0, 2])
    b0, b1, b2 = rho * kind(slope[1, 0]), rho * kind(slope[1, 1]), rho * kind(slope[1, 2])
    for k in range(one.shape[1]):
        rows[0, k] += rho * one[0, k]
        rows[1, k] += rho * one[1, k]
        rows[2, k] += a0 * one[2, k] + a1 * one[3, k] + a2 * one[4, k]
        rows[3, k] += b0 * one[2, k] + b1 * one[3, k] + b2 * one[4, k]


@kernel(fastmath=FAST, error_model="numpy")
def _add_scaled(row, factor, out):
    for k in range(out.size):
        out[k] += factor * row[k]


@kernel(fastmath=FAST, error_model="numpy")
def _times(a, b, out):
    for k in range(out.size):
        out[k] = a[k] * b[k]


@kernel(fastmath=FAST, error_model="numpy")
def _residuals(light, floor, weight, model, held):
    """`model` becomes the weighted residual, `held` the weights (0 where a clipped sample's model is above it); the cost."""
    cost = ZERO * light[0]
    for k in range(light.size):
        r, w, clipped = model[k] - light[k], weight[k], floor[k]
        w = w if (clipped == ZERO) | (r <= ZERO) else ZERO
        held[k] = w
        model[k] = w * r
        cost += w * r * r
    return float(cost)


@kernel(fastmath=FAST, error_model="numpy")
def _dot(a, b):
    s = ZERO * a[0]
    for k in range(a.size):
        s += a[k] * b[k]
    return s


@kernel(error_model="numpy")
def _optimise(lobe, frame, x, o, h, i, light, floor, weight, prior, n_d, tolerance, rows, one):
    """Levenberg-Marquardt in place on (frame, x), weights held at 0 while they want to be negative. Returns passes."""
    matrix, gradient = scratch.matrix(SIZE, SIZE), scratch.vector(SIZE)
    matrix2, gradient2 = scratch.matrix(SIZE, SIZE), scratch.vector(SIZE)
    system, right, step = scratch.matrix(SIZE, SIZE), scratch.vector(SIZE), scratch.vector(SIZE)
    x2, frame2 = scratch.vector(LENGTH), scratch.matrix(3, 3)
    size = weighted_square(light, weight)
    if not size > 0:
        return 0
    cost = mixed_equations(lobe, frame, x, o, h, i, light, floor, weight, rows, one, prior, n_d, matrix, gradient)
    damping, passes = 1e-3, 1
    for _ in range(STEPS):
        norm = 0.0
        for j in range(SIZE):
            right[j] = gradient[j]
            held = j >= 4 and x[j - 1] <= 0 and gradient[j] > 0
            for k in range(SIZE):
                system[j, k] = 0.0 if held or (k >= 4 and x[k - 1] <= 0 and gradient[k] > 0) else matrix[j, k]
            if held:
                system[j, j], right[j] = 1.0, 0.0
            else:
                system[j, j] = matrix[j, j] * (1 + damping) + 1e-9 * size
                norm += (gradient[j] * (x[j - 1] if j >= 4 else 1.0)) ** 2
        if math.sqrt(norm) < tolerance * size:
            break
        if not cholesky_solve(system, right, SIZE, step):
            damping = max(10 * damping, 1e-3)
            continue
        limit = max(max(abs(step[0]), abs(step[1])), max(abs(step[2]), abs(step[3])))
        scale = min(1.0, 0.4 / limit) if limit > 0 else 1.0
        tilt(frame, -scale * step[0], -scale * step[1], frame2)
        copy1(x, x2)
        for k in range(2):
            x2[k] = min(max(x[k] - scale * step[2 + k], LOG_MIN), LOG_MAX)
        for j in range(DIRECTIONS):
            x2[3 + j] = max(x[3 + j] - scale * step[4 + j], 0.0)
        cost2 = mixed_equations(lobe, frame2, x2, o, h, i, light, floor, weight, rows, one, prior, n_d, matrix2, gradient2)
        passes += 1
        if cost2 < cost * (1 + 1e-6):
            copy2(frame2, frame)
            copy2(matrix2, matrix)
            copy1(x2, x)
            copy1(gradient2, gradient)
            done = cost - cost2 < 1e-4 * cost
            cost = cost2
            damping = damping * 0.2 if damping > 1e-9 else 0.0
            if done:
                break
        else:
            damping = max(8 * damping, 1e-4)
            if damping > 1e6:
                break
    return passes


@kernel(error_model="numpy")
def mixed_values(lobe, frame, x, o, h, i, one, g):
    """Radiance per unit irradiance of the mixture, into `g` [N]; `one` [N] is workspace."""
    shape, slope = scratch.vector(3), scratch.matrix(2, 3)
    g[:] = ZERO
    kind = g.dtype.type
    for j in range(DIRECTIONS):
        if x[3 + j] > 0:
            shape_of(x[0], x[1], direction(x, j), shape, slope)
            values(lobe, frame, shape, o, h, i, one)
            rho = kind(x[3 + j])
            for k in range(g.size):
                g[k] += rho * one[k]


@kernel(error_model="numpy")
def _pack(frame, reach, h, i, light, floor, use, chosen, workspace):
    """The lights in use whose half vector lies within `reach` (tangent of the angle from the normal), [9, n] in `workspace`."""
    count = 0
    for k in range(light.size):
        z = h[0][k] * frame[2, 0] + h[1][k] * frame[2, 1] + h[2][k] * frame[2, 2]
        if use[k] > 0 and z > 0 and z * z * (1.0 + reach * reach) > 1.0:
            chosen[count] = k
            count += 1
    out = scratch.folded(workspace, 9, count)
    for n in range(count):
        k = chosen[n]
        out[0, n], out[1, n], out[2, n] = h[0][k], h[1][k], h[2][k]
        out[3, n], out[4, n], out[5, n] = i[0][k], i[1][k], i[2][k]
        out[6, n], out[7, n], out[8, n] = light[k], floor[k], use[k]
    return out


@kernel(error_model="numpy")
def fit_mixed(lobe, frame, x, large, small, angle, rho, o, h, i, light, floor, use, absolute, relative, prior, n_d, tolerance,
              limit, weight, g, workspace):  # fmt: skip
    """Fit the mixture from one lobe (large, small, angle, rho), in place on (frame, x [3 + DIRECTIONS]).

    weight, g [N] are left with the robust weights and the mixture's values. Ends early when the first round does not
    reach `limit`, the cost to beat, or fewer than two lights a parameter show the lobe. Returns (robust cost, passes).
    """
    kind = light.dtype.type
    near = _pack(frame, (TAIL if lobe == GGX else REACH) * large, h, i, light, floor, use, workspace.front, workspace.spare)
    x[0], x[1], x[2] = math.log(large) + 0.15, math.log(small) - 0.3, angle
    for j in range(DIRECTIONS):
        x[3 + j] = rho * (0.5 if j == 0 else 0.5 / (DIRECTIONS - 1))
    n = near.shape[1]
    if n < 2 * SIZE:
        return np.inf, 0
    spare = workspace.spare[9 * n :]
    rows, one = scratch.folded(spare, SIZE, n), scratch.folded(spare[SIZE * n :], 6, n)
    robust = spare[(SIZE + 6) * n : (SIZE + 7) * n]
    h2, i2 = (near[0], near[1], near[2]), (near[3], near[4], near[5])
    copy1(near[8], robust)
    passes, cost = 0, 0.0
    for turn in range(ROUNDS):
        passes += _optimise(lobe, frame, x, o, h2, i2, near[6], near[7], robust, prior, n_d, tolerance, rows, one)
        if turn < ROUNDS - 1:
            mixed_values(lobe, frame, x, o, h2, i2, one[0], one[1])
            reweight(one[1], kind(1.0), near[6], near[8], absolute, relative, robust)
        if turn == 0 or turn == ROUNDS - 1:
            mixed_values(lobe, frame, x, o, h, i, weight, g)
            cost = reweight(g, kind(1.0), light, use, absolute, relative, weight)
            if cost > limit:
                break
    if x[1] > x[0]:  # the widths have changed places
        x[0], x[1] = x[1], x[0]
        x[2] += 0.5 * math.pi
    return cost, passes


@kernel(error_model="numpy")
def concentration(x):
    """(total weight, principal angle, order): order is 1 where all the light has one tangent, 0 where none is preferred."""
    total = c = s = 0.0
    for j in range(DIRECTIONS):
        total += x[3 + j]
        c += x[3 + j] * math.cos(2 * direction(x, j))
        s += x[3 + j] * math.sin(2 * direction(x, j))
    return total, 0.5 * math.atan2(s, c), math.sqrt(c * c + s * s) / total if total > 0 else 0.0
