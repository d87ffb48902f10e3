"""Specular lobes and their derivatives over the lights of one pixel.

Radiance is `rho g E`. With the half vector h in the frame (t, b, n) of the surface and `q = |Lᵀ (h·t, h·b)|²`,
`L = [[e^A, 0], [C, e^B]]` (log-Cholesky of the inverse squared widths: smooth through the round lobe, positive definite):

    WARD            g = exp(-2 q / (1 + h·n)) e^(A+B) / (4 pi n·o)            Ward-Duer with its cosine
    BECKMANN        g = exp(-q / (h·n)²) G1(i) G1(o) e^(A+B) / (4 pi (h·n)⁴ n·o)  microfacets, Smith's G
    PRINTED         g = exp(-2 q / (1 + h·n)) e^(A+B) / (4 pi sqrt((n·o)(n·i)))   PRF Eq. 14 without a cosine
    PRINTED_COSINE  the printed lobe times n·i

Derivatives are with respect to (d1, d2) = tilt of n along t and b, (A, B, C) and rho. G1 is the rational fit of
Walter et al. 2007, Eq. 27, as renderers use it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.lights.numerics import FAST, FOUR, HALF, ONE, TINY, TWO, ZERO, exp

WARD, BECKMANN, PRINTED, PRINTED_COSINE = 0, 1, 2, 3
LOBES = {"ward": WARD, "beckmann": BECKMANN, "printed": PRINTED, "printed-cosine": PRINTED_COSINE}

INVERSE_4PI = 1.0 / (4.0 * math.pi)
VIEW_FLOOR = 0.01  # n·o below it (0.6 degrees from grazing) is held there: 1/(n·o) would run away
LIGHT_FLOOR = np.float32(0.01)  # the same for n·i under the printed lobe's square root

G_A, G_B, G_C, G_D = (np.float32(v) for v in (3.535, 2.181, 2.276, 2.577))
G_ONE = np.float32(1 / 1.6)  # below this alpha tan(theta) nothing is masked


@njit(cache=True, fastmath=FAST)
def _ward(hx, hy, hn, inn, ea, eb, c, rho, factor, ox, oy, cosine, root, j0, j1, j2, j3, j4, j5, ix, iy):
    """Ward's lobe (cosine and root 0), or the printed one: root 1/2 takes sqrt((n·o)/(n·i)), cosine 1 multiplies n·i."""
    for k in range(hx.size):
        x, y, z = hx[k], hy[k], hn[k]
        u0, u1 = ea * x + c * y, eb * y
        q = u0 * u0 + u1 * u1
        i = TWO / (ONE + z)
        i2 = TWO * i
        g = factor * exp(-q * i)
        j2[k] = ONE - i2 * ea * u0 * x
        j3[k] = ONE - i2 * u1 * u1
        j4[k] = -i2 * u0 * y
        j0[k] = i2 * z * ea * u0 + HALF * q * i * i * x - ox
        j1[k] = i2 * z * (c * u0 + eb * u1) + HALF * q * i * i * y - oy
        j5[k] = g
    if root != 0:
        power = cosine - root
        for k in range(hx.size):
            n = max(inn[k], LIGHT_FLOOR)
            j5[k] *= n**power
            j0[k] += power * ix[k] / n
            j1[k] += power * iy[k] / n
    for k in range(hx.size):
        p = rho * j5[k]
        j0[k] *= p
        j1[k] *= p
        j2[k] *= p
        j3[k] *= p
        j4[k] *= p


@njit(cache=True, fastmath=FAST, inline="always")
def _smith(x, y, z, ea, eb, c):
    """G1 of a direction (x, y, z) in the frame, and d log G1 by d1, d2, A, B, C."""
    fa, fb = ONE / ea, ONE / eb
    z = max(z, LIGHT_FLOOR)
    v0 = x * fa
    v1 = (y - c * v0) * fb
    square = v0 * v0 + v1 * v1 + TINY
    root = math.sqrt(square)
    s = root / z
    top, bottom = G_A * s + G_B, s * s + G_C * s + G_D
    below = s < G_ONE
    g = ONE if below else top / bottom
    slope = ZERO * s if below else (G_A / top - (TWO * s + G_C) / bottom) * s  # by log s
    i = ONE / square
    w0, w1 = fa * (v0 - c * fb * v1), fb * v1  # half the gradient of the square by x and y
    return (
        g,
        slope * (-z * w0 * i - x / z),
        slope * (-z * w1 * i - y / z),
        slope * i * (-v0 * v0 + c * fb * v0 * v1),
        -slope * i * v1 * v1,
        -slope * i * v0 * v1 * fb,
    )


@njit(cache=True, fastmath=FAST)
def _beckmann(hx, hy, hn, ea, eb, c, rho, factor, ox, oy, ix, iy, inn, view, j0, j1, j2, j3, j4, j5):
    g0, v0, v1, v2, v3, v4 = view
    for k in range(hx.size):
        x, y, z = hx[k], hy[k], hn[k]
        u0, u1 = ea * x + c * y, eb * y
        q = u0 * u0 + u1 * u1
        f = ONE / z
        i = f * f
        i2 = TWO * i
        g, s0, s1, s2, s3, s4 = _smith(ix[k], iy[k], inn[k], ea, eb, c)
        g *= factor * g0 * i * i * exp(-q * i)
        p = rho * g
        along = (i2 * q - FOUR) * f
        j0[k] = p * (i2 * z * ea * u0 + along * x - ox + s0 + v0)
        j1[k] = p * (i2 * z * (c * u0 + eb * u1) + along * y - oy + s1 + v1)
        j2[k] = p * (ONE - i2 * ea * u0 * x + s2 + v2)
        j3[k] = p * (ONE - i2 * u1 * u1 + s3 + v3)
        j4[k] = p * (-i2 * u0 * y + s4 + v4)
        j5[k] = g


@njit(cache=True, fastmath=FAST)
def _rotate(vx, vy, vz, frame, out_t, out_b, out_n):
    kind = vx.dtype.type
    tx, ty, tz = kind(frame[0, 0]), kind(frame[0, 1]), kind(frame[0, 2])
    bx, by, bz = kind(frame[1, 0]), kind(frame[1, 1]), kind(frame[1, 2])
    nx, ny, nz = kind(frame[2, 0]), kind(frame[2, 1]), kind(frame[2, 2])
    for k in range(vx.size):
        x, y, z = vx[k], vy[k], vz[k]
        out_t[k] = tx * x + ty * y + tz * z
        out_b[k] = bx * x + by * y + bz * z
        out_n[k] = nx * x + ny * y + nz * z


@njit(cache=True)
def evaluate(lobe, frame, shape, rho, o, h, i, local, jacobian):
    """Fill `jacobian` [6, N] at the parameters: rows d(rho g) by d1, d2, A, B, C, and g itself (= by rho).

    frame float64 [3, 3]: rows t, b, n; shape float64 [3]: A, B, C; o [3]: to the camera; h, i [3, N]: half vectors and
    directions to the lights, world; local [6, N]: workspace.
    """
    kind = h.dtype.type
    _rotate(h[0], h[1], h[2], frame, local[0], local[1], local[2])
    if lobe != WARD:
        _rotate(i[0], i[1], i[2], frame, local[3], local[4], local[5])
    ot = frame[0, 0] * o[0] + frame[0, 1] * o[1] + frame[0, 2] * o[2]
    ob = frame[1, 0] * o[0] + frame[1, 1] * o[1] + frame[1, 2] * o[2]
    on = frame[2, 0] * o[0] + frame[2, 1] * o[1] + frame[2, 2] * o[2]
    held = max(on, VIEW_FLOOR)
    free = 1.0 if on > VIEW_FLOOR else 0.0
    a, b, c = math.exp(shape[0]), math.exp(shape[1]), shape[2]
    factor = a * b * INVERSE_4PI / held
    slant_t, slant_b = free * ot / held, free * ob / held
    root = cosine = 0.0
    if lobe >= PRINTED:
        factor *= math.sqrt(held)
        slant_t, slant_b = 0.5 * slant_t, 0.5 * slant_b
        root = 0.5
        cosine = 1.0 if lobe == PRINTED_COSINE else 0.0
    j = jacobian
    ea, eb, ec, p, f, ox, oy = kind(a), kind(b), kind(c), kind(rho), kind(factor), kind(slant_t), kind(slant_b)
    if lobe == BECKMANN:
        view = _smith(kind(ot), kind(ob), kind(held), ea, eb, ec)
        _beckmann(local[0], local[1], local[2], ea, eb, ec, p, f, ox, oy, local[3], local[4], local[5], view,
                  j[0], j[1], j[2], j[3], j[4], j[5])  # fmt: skip
    else:
        _ward(local[0], local[1], local[2], local[5], ea, eb, ec, p, f, ox, oy, kind(cosine), kind(root),
              j[0], j[1], j[2], j[3], j[4], j[5], local[3], local[4])  # fmt: skip


@njit(cache=True, fastmath=FAST)
def _products(u, v0, v1, v2, v3, v4, v5, weight, out):
    """Weighted inner products of u with six rows."""
    a = b = c = d = e = f = ZERO * u[0]
    for k in range(u.size):
        w = weight[k] * u[k]
        a += w * v0[k]
        b += w * v1[k]
        c += w * v2[k]
        d += w * v3[k]
        e += w * v4[k]
        f += w * v5[k]
    out[0], out[1], out[2], out[3], out[4], out[5] = a, b, c, d, e, f


@njit(cache=True, fastmath=FAST)
def _residual(g, rho, light, floor, weight, out):
    """out = rho g - light (for a floor sample, clipped when recorded: only where the lobe falls short). Weighted square sum."""
    cost = ZERO * rho
    for k in range(g.size):
        r = rho * g[k] - light[k]
        r = r if floor[k] == ZERO else min(r, ZERO)
        out[k] = r
        cost += weight[k] * r * r
    return cost


@njit(cache=True)
def normal_equations(jacobian, rho, light, floor, weight, residual, matrix, gradient):
    """Gauss-Newton matrix float64 [6, 6] and gradient [6] of half the weighted square residual; returns its cost.

    Samples with `floor` 1 are lower bounds (clipped): they count only where the lobe stays below them.
    """
    cost = _residual(jacobian[5], residual.dtype.type(rho), light, floor, weight, residual)
    j = jacobian
    _products(residual, j[0], j[1], j[2], j[3], j[4], j[5], weight, gradient)
    for k in range(6):
        _products(j[k], j[0], j[1], j[2], j[3], j[4], j[5], weight, matrix[k])
    return cost
