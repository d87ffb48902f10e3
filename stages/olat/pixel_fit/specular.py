"""Specular lobe of one pixel: start from half vectors and their second moments, then a joint robust fit.

The fit is Levenberg-Marquardt over the normal (2), the widths and tangent (3) and the albedo at once: PRF Eqs. 13, 14
and 17 in one objective, with the paper's fixed tangent set free.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.kernels import scratch
from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, ONE, ZERO, cholesky_solve, copy1, copy2
from pipeline.rig.lobes import normal_equations
from stages.olat.pixel_fit.normal_matrix import inverse_form

LOBE_FRACTION = 0.05  # of the brightest sample: below it noise, not the lobe, would weigh the half vectors
LEAST_COSINE = np.float32(0.05)  # h·o below it is all but opposite the view: no lobe of a surface that is seen
SIGMA_MIN, SIGMA_MAX = 1e-3, 10.0
SHAPE_MAX, SHAPE_MIN = -math.log(SIGMA_MIN), -math.log(SIGMA_MAX)


@kernel(error_model="numpy")
def frame_about(nx, ny, nz, frame):
    """Rows t, b, n of an orthonormal frame about a unit normal (Duff et al. 2017: no singular direction)."""
    sign = math.copysign(1.0, nz)
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    frame[0, 0], frame[0, 1], frame[0, 2] = 1.0 + sign * nx * nx * a, sign * b, -sign * nx
    frame[1, 0], frame[1, 1], frame[1, 2] = b, sign + ny * ny * a, -ny
    frame[2, 0], frame[2, 1], frame[2, 2] = nx, ny, nz


@kernel(error_model="numpy")
def tilt(frame, d1, d2, out):
    """The frame whose normal is `n + d1 t + d2 b`, t kept as near as it can be."""
    for i in range(3):
        out[2, i] = frame[2, i] + d1 * frame[0, i] + d2 * frame[1, i]
    size = math.sqrt(out[2, 0] ** 2 + out[2, 1] ** 2 + out[2, 2] ** 2)
    dot = 0.0
    for i in range(3):
        out[2, i] /= size
        dot += out[2, i] * frame[0, i]
    for i in range(3):
        out[0, i] = frame[0, i] - dot * out[2, i]
    size = math.sqrt(out[0, 0] ** 2 + out[0, 1] ** 2 + out[0, 2] ** 2)
    for i in range(3):
        out[0, i] /= size
    out[1, 0] = out[2, 1] * out[0, 2] - out[2, 2] * out[0, 1]
    out[1, 1] = out[2, 2] * out[0, 0] - out[2, 0] * out[0, 2]
    out[1, 2] = out[2, 0] * out[0, 1] - out[2, 1] * out[0, 0]


@kernel(fastmath=FAST, error_model="numpy")
def half_vectors(ix, iy, iz, ox, oy, oz, hx, hy, hz, cosine):
    """Half vectors of the lights and `o`, and their cosine h·o (0 where the light is exactly opposite)."""
    for k in range(ix.size):
        x, y, z = ix[k] + ox, iy[k] + oy, iz[k] + oz
        s = x * x + y * y + z * z
        r = ONE / math.sqrt(s) if s > ZERO else ZERO
        hx[k], hy[k], hz[k] = x * r, y * r, z * r
        cosine[k] = (x * ox + y * oy + z * oz) * r


@kernel(fastmath=FAST, error_model="numpy")
def _sums(light, use, floor):
    top = whole = squares = clipped = noise = negative = ZERO * light[0]
    for k in range(light.size):
        v, u, clip = light[k], use[k], floor[k]
        under = v < ZERO
        noise += v * v if under else ZERO
        negative += ONE if under else ZERO
        v = v if (u > ZERO) & (not under) else ZERO
        top = max(top, v)
        whole += v
        squares += v * v
        clipped += v if clip > ZERO else ZERO
    return top, whole, squares, clipped, noise, negative


@kernel(error_model="numpy")
def sums(light, use, floor):
    """Of the samples in use: largest, sum, sum of squares, sum of the clipped; and the deviation that negative ones betray."""
    top, whole, squares, clipped, noise, negative = _sums(light, use, floor)
    deviation = math.sqrt(noise / negative) if negative > 0 else 0.0
    return float(top), float(whole), float(squares), float(clipped), deviation


@kernel(fastmath=FAST, error_model="numpy")
def _weighted(light, weight, level, area, hx, hy, hz, cosine):
    x = y = z = n = ZERO * level
    for k in range(light.size):
        v, c, used = light[k], cosine[k], weight[k]
        chosen = (v > level) & (used > ZERO) & (c > LEAST_COSINE)
        w = v * area[k] / max(c, LEAST_COSINE)
        w = w if chosen else ZERO
        x += w * hx[k]
        y += w * hy[k]
        z += w * hz[k]
        n += ONE if chosen else ZERO
    return x, y, z, n


@kernel(error_model="numpy")
def start_normal(light, weight, level, area, h, cosine):
    """Weighted half vector `Σ I ΔΩ h / (h·o)` over samples above `level`. Returns its direction and the samples' number."""
    sx, sy, sz, count = _weighted(light, weight, light.dtype.type(level), area, h[0], h[1], h[2], cosine)
    x, y, z = np.float64(sx), np.float64(sy), np.float64(sz)  # numba's float() would leave them as they are
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size, int(count)) if size > 0 else (0.0, 0.0, 0.0, 0)


@kernel(fastmath=FAST, error_model="numpy")
def _moments(light, weight, level, area, hx, hy, hz, cosine, tx, ty, tz, bx, by, bz):
    xx = xy = yy = total = ZERO * level
    for k in range(light.size):
        v, c, used = light[k], cosine[k], weight[k]
        chosen = (v > level) & (used > ZERO) & (c > LEAST_COSINE)
        w = v * area[k] / max(c, LEAST_COSINE)
        w = w if chosen else ZERO
        x = hx[k] * tx + hy[k] * ty + hz[k] * tz
        y = hx[k] * bx + hy[k] * by + hz[k] * bz
        xx += w * x * x
        xy += w * x * y
        yy += w * y * y
        total += w
    return float(xx), float(xy), float(yy), float(total)


@kernel(error_model="numpy")
def start_shape(light, weight, level, area, h, cosine, frame, shape):
    """A, B, C from the second moments of the projected half vectors (variance = sigma² / 2 in each direction)."""
    kind = light.dtype.type
    t, b = (kind(frame[0, 0]), kind(frame[0, 1]), kind(frame[0, 2])), (kind(frame[1, 0]), kind(frame[1, 1]), kind(frame[1, 2]))
    xx, xy, yy, total = _moments(light, weight, kind(level), area, h[0], h[1], h[2], cosine, t[0], t[1], t[2], b[0], b[1], b[2])
    xx, xy, yy = 2 * xx / total + 1e-4, 2 * xy / total, 2 * yy / total + 1e-4  # 1e-4: sigma no narrower than 0.01 to start
    set_shape(xx, xy, yy, shape)


@kernel(error_model="numpy")
def set_shape(xx, xy, yy, shape):
    """Log-Cholesky of the inverse of the width matrix [[xx xy] [xy yy]] (sigma squared)."""
    det = xx * yy - xy * xy
    a2 = yy / det  # entry (0, 0) of the inverse
    a = math.sqrt(a2)
    c = -xy / det / a  # L = [[a, 0], [c, b]] in q = (a x + c y)² + (b y)²
    b2 = xx / det - c * c
    shape[0], shape[1], shape[2] = math.log(a), 0.5 * math.log(b2), c


@kernel(error_model="numpy")
def widths(shape):
    """(sigma of the larger axis, of the smaller, angle of the larger axis from t) of A, B, C."""
    a, b, c = math.exp(shape[0]), math.exp(shape[1]), shape[2]
    xx, xy, yy = a * a, a * c, c * c + b * b  # inverse of the width matrix
    mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    root = math.sqrt(half * half + xy * xy)
    large = mean + root
    small = (a * b) ** 2 / large  # not mean - root, which cancels
    angle = 0.5 * math.atan2(2 * xy, xx - yy) + 0.5 * math.pi  # the narrow axis has the large eigenvalue
    return 1.0 / math.sqrt(small), 1.0 / math.sqrt(large), angle


@kernel(error_model="numpy")
def optimise(lobe, frame, shape, rho, o, h, i, light, floor, weight, isotropic, prior, n_d, steps, tolerance, matrix):
    """Levenberg-Marquardt in place on (frame, shape, rho[0]) until the gradient, in units of the data, is under `tolerance`.

    light, floor, weight [N]: samples, lower bounds, weights; isotropic: A = B and C = 0; prior: stiffness (in units of the
    weighted square residual) that holds n to `n_d`; matrix [6, 6]: left with the normal equations at the end, without B and
    with C's place taken by rho's where isotropic. Returns (by how much a Newton step would still lower twice the cost, gradient
    norm, passes).
    """
    gradient = scratch.vector(6)
    matrix2, gradient2 = scratch.matrix(6, 6), scratch.vector(6)
    system, step = scratch.matrix(6, 6), scratch.vector(6)
    frame2, shape2 = scratch.matrix(3, 3), scratch.vector(3)
    size = weighted_square(light, weight)
    matrix[:] = 0.0
    if not size > 0:
        return 0.0, 0.0, 0
    cost = normal_equations(lobe, frame, shape, rho[0], o, h, i, light, floor, weight, isotropic, matrix, gradient)
    cost += hold(frame, n_d, prior, matrix, gradient)
    damping, norm, passes = 1e-3, 0.0, 1
    n = 4 if isotropic else 6
    norm = _norm(gradient, n, rho[0], size)
    for _ in range(steps):
        if norm < tolerance:
            break
        for j in range(n):
            for k in range(n):
                system[j, k] = matrix[j, k]
            system[j, j] += damping * matrix[j, j] + 1e-12 * size  # an unseen direction stays put
        if not cholesky_solve(system, gradient, n, step):
            damping = max(10 * damping, 1e-3)
            continue
        if max(abs(step[0]), abs(step[1]), abs(step[2]), abs(step[3])) < 0.1 * tolerance:
            break  # a step below rounding
        limit = max(abs(step[0]), abs(step[1]), 0.4 * abs(step[2]), 0.4 * abs(step[3]) if not isotropic else 0.0)
        scale = min(1.0, 0.3 / limit) if limit > 0 else 1.0  # at most 17 degrees or a factor of two in width a step
        tilt(frame, -scale * step[0], -scale * step[1], frame2)
        shape2[0] = min(max(shape[0] - scale * step[2], SHAPE_MIN), SHAPE_MAX)
        shape2[1] = shape2[0] if isotropic else min(max(shape[1] - scale * step[3], SHAPE_MIN), SHAPE_MAX)
        shape2[2] = 0.0 if isotropic else shape[2] - scale * step[4]
        rho2 = max(rho[0] - scale * step[n - 1], 0.0)
        cost2 = normal_equations(lobe, frame2, shape2, rho2, o, h, i, light, floor, weight, isotropic, matrix2,
                                 gradient2)  # fmt: skip
        cost2 += hold(frame2, n_d, prior, matrix2, gradient2)
        passes += 1
        if cost2 < cost * (1 + 1e-6):  # equal within rounding counts: the gradient decides when to stop
            rho[0], cost = rho2, cost2
            copy2(frame2, frame)
            copy1(shape2, shape)
            copy2(matrix2, matrix)
            copy1(gradient2, gradient)
            damping = damping * 0.1 if damping > 1e-9 else 0.0
            norm = _norm(gradient, n, rho[0], size)
        else:
            damping = max(8 * damping, 1e-4)
            if damping > 1e6:
                break
    return inverse_form(matrix, gradient, n), norm, passes


@kernel(fastmath=FAST, error_model="numpy")
def weighted_square(light, weight):
    """Weighted square norm of the samples."""
    s = ZERO * light[0]
    for k in range(light.size):
        s += weight[k] * light[k] * light[k]
    return float(s)


@kernel(error_model="numpy")
def hold(frame, n_d, prior, matrix, gradient):
    """Add the prior `prior |n - n_d|²` (chord, exact gradient in the tilt) to the normal equations; returns its cost."""
    if prior <= 0:
        return 0.0
    t = frame[0, 0] * n_d[0] + frame[0, 1] * n_d[1] + frame[0, 2] * n_d[2]
    b = frame[1, 0] * n_d[0] + frame[1, 1] * n_d[1] + frame[1, 2] * n_d[2]
    n = frame[2, 0] * n_d[0] + frame[2, 1] * n_d[1] + frame[2, 2] * n_d[2]
    gradient[0] -= prior * t
    gradient[1] -= prior * b
    matrix[0, 0] += prior * max(n, 0.5)
    matrix[1, 1] += prior * max(n, 0.5)
    return 2.0 * prior * (1.0 - n)


@kernel(error_model="numpy")
def _norm(gradient, n, rho, size):
    s = 0.0
    for k in range(n):
        g = gradient[k] * (rho if k == n - 1 else 1.0)
        s += g * g
    return math.sqrt(s) / size


@kernel(fastmath=FAST, error_model="numpy")
def reweight(g, rho, light, use, absolute, relative, weight):
    """Geman-McClure weights of the residual in units of `absolute + relative x max(model, sample)`; returns the robust cost."""
    cost = ZERO * rho
    for k in range(g.size):
        p = rho * g[k]
        t = (p - light[k]) / (absolute + relative * max(p, light[k]))
        u = ONE / (ONE + t * t)
        weight[k] = use[k] * u * u
        cost += use[k] * t * t * u
    return cost
