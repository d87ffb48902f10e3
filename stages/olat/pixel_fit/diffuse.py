"""Diffuse normal and albedo of one pixel: least squares on the lights that reach it.

PRF Eq. 12 on a fixed active set is linear least squares (the maximiser of the correlation is `(ΩᵀΩ)⁻¹ Ωᵀ I`); shadows
and inter-reflection are told apart from direct light by the residual, and the set is updated with the normal.
"""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, HALF, ONE, ZERO, kth_largest, solve3

START_FRACTION = 0.3  # of the fifth-brightest sample: above it a light is surely not shadowed
TUNING = 2.5  # Geman-McClure scale in standard deviations of the residual
SCALE_FLOOR = 4e-3  # of the brightest possible sample: half floats and path-tracing noise; below it weights are all one
SHADOWED = 0.5  # a sample under this fraction of its prediction is in shadow
GRAZING = 0.02  # cosine below which a light says nothing about the normal
MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


@kernel(fastmath=FAST, error_model="numpy")
def weighted_equations(light, ok, wx, wy, wz, bx, by, bz, grazing, shadowed, level, inverse, weight):
    """Geman-McClure weights of lights that are not shadowed, and the normal equations under them, in one pass.

    b: scaled normal that predicts the samples; a light counts whose prediction is above `grazing` and whose sample is above
    `shadowed` of it plus `level`; inverse: of the weights' scale (0: all weigh 1). `weight` [N] is filled. Returns the
    equations (six of the matrix, three of the right side), the weighted square residual and the weights' sum.
    """
    a = b = c = d = e = f = x = y = z = ss = sw = ZERO * light[0]
    for k in range(light.size):
        v = light[k]
        prediction = bx * wx[k] + by * wy[k] + bz * wz[k]
        residual = v - prediction
        t = residual * inverse
        u = ONE / (ONE + t * t)
        w = ok[k] * u * u
        w = w if (prediction > grazing) and (v > shadowed * prediction + level) else ZERO
        weight[k] = w
        ss += w * residual * residual
        sw += w
        p, q, r = w * wx[k], w * wy[k], w * wz[k]
        a += p * wx[k]
        b += p * wy[k]
        c += p * wz[k]
        d += q * wy[k]
        e += q * wz[k]
        f += r * wz[k]
        x += p * v
        y += q * v
        z += r * v
    return a, b, c, d, e, f, x, y, z, ss, sw


@kernel(fastmath=FAST, error_model="numpy")
def _residuals(light, ok, wx, wy, wz, bx, by, bz, grazing, work):
    """Absolute residuals of the lit samples into `work` (-1: not one of them); returns their number."""
    n = ZERO * light[0]
    for k in range(light.size):
        p = bx * wx[k] + by * wy[k] + bz * wz[k]
        v, usable = light[k], ok[k]
        lit = (usable > ZERO) & (p > grazing) & (v > HALF * p)
        work[k] = abs(v - p) if lit else -ONE
        n += ONE if lit else ZERO
    return n


@kernel(error_model="numpy")
def _residual_scale(light, ok, wx, wy, wz, bx, by, bz, grazing, work):
    n = int(_residuals(light, ok, wx, wy, wz, bx, by, bz, grazing, work))
    return MAD * kth_largest(work, n // 2) if n > 0 else 0.0


@kernel(fastmath=FAST, error_model="numpy")
def _usable(light, ok, work):
    """The samples that can be used into `work` (-1: cannot); returns their number."""
    n = ZERO * light[0]
    for k in range(light.size):
        v, fine = light[k], ok[k] > ZERO
        work[k] = v if fine else -ONE
        n += ONE if fine else ZERO
    return n


@kernel(error_model="numpy")
def fit_normal(light, ok, wx, wy, wz, rounds, plain, weight, work):
    """Scaled diffuse normal `m` = (albedo x normal) of one pixel.

    light [N]: I_d over irradiance factor; ok [N]: 1 usable, 0 not; w [N]: directions to the lights; `weight` [N] is
    filled with the final weights; plain: every light before the surface counts fully, PRF Eq. 12.
    Returns (mx, my, mz, residual scale, lights in use, solved).
    """
    usable = int(_usable(light, ok, work))
    if usable < 3:
        for k in range(light.size):
            weight[k] = ZERO
        return 0.0, 0.0, 0.0, 0.0, usable, False
    top = kth_largest(work, min(4, usable - 1))
    solved = False
    kind = light.dtype.type
    mx = my = mz = 0.0
    if top > 0:
        for fraction in (0.0 if plain else START_FRACTION, 0.1, 0.02, 0.0):
            a, b, c, d, e, f, x, y, z, _, n = weighted_equations(
                light, ok, wx, wy, wz, ZERO, ZERO, ZERO, -ONE, ZERO, kind(fraction * top), ZERO, weight
            )
            if n >= 3:
                mx, my, mz, solved = solve3(a, b, c, d, e, f, x, y, z)
            if solved:
                break
    if not solved:
        return 0.0, 0.0, 0.0, 0.0, usable, False
    return refined(light, ok, wx, wy, wz, mx, my, mz, usable, rounds, plain, weight, work)


@kernel(error_model="numpy")
def refined(light, ok, wx, wy, wz, mx, my, mz, usable, rounds, plain, weight, work):
    """The reweighted rounds of `fit_normal` from a start m, of `usable` samples; its result."""
    kind = light.dtype.type
    scale, used = 0.0, usable
    for step in range(rounds):
        size = math.sqrt(mx * mx + my * my + mz * mz)
        bx, by, bz, grazing = kind(mx), kind(my), kind(mz), kind(GRAZING * size)
        if step < 3:
            scale = _residual_scale(light, ok, wx, wy, wz, bx, by, bz, grazing, work)
        scale = max(scale, SCALE_FLOOR * size)
        inverse, shadowed = kind(0.0 if plain else 1.0 / (TUNING * scale)), kind(-1e30 if plain else SHADOWED)
        if plain:
            grazing = ZERO
        a, b, c, d, e, f, x, y, z, ss, sw = weighted_equations(
            light, ok, wx, wy, wz, bx, by, bz, kind(grazing), shadowed, ZERO, inverse, weight
        )
        nx, ny, nz, fine = solve3(a, b, c, d, e, f, x, y, z)
        if not fine or sw < 3.0 * HALF:
            break
        change = abs(nx - mx) + abs(ny - my) + abs(nz - mz)
        mx, my, mz = nx, ny, nz
        if step >= 2:
            scale = math.sqrt(ss / sw) * 1.22  # Gaussian residuals under these weights have 0.82 of their deviation
        if step > 2 and change < 1e-7 * size:
            break
    return mx, my, mz, scale, used, True


@kernel(fastmath=FAST, error_model="numpy")
def channel_albedo(rgb, wx, wy, wz, nx, ny, nz, weight, out):
    """PRF Eq. 16: ratio of two dot products over the lights in use; `out` [3] is filled."""
    r = g = b = den = ZERO * nx
    for k in range(weight.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        w = weight[k] * p
        r += w * rgb[0, k]
        g += w * rgb[1, k]
        b += w * rgb[2, k]
        den += w * p
    if den > ZERO:
        out[0], out[1], out[2] = r / den, g / den, b / den
    else:
        out[0] = out[1] = out[2] = ZERO


@kernel(fastmath=FAST, error_model="numpy")
def in_use_of(weight):
    """Sum of the weights, and how many of them count."""
    s = n = ZERO * weight[0]
    for k in range(weight.size):
        s += weight[k]
        n += ONE if weight[k] > HALF * HALF else ZERO
    return float(s), float(n)
