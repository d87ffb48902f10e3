"""Specular lobes and their derivatives over the lights of one pixel.

Radiance is `rho g E`. With the half vector h in the frame (t, b, n) of the surface and `q = |Lᵀ (h·t, h·b)|²`,
`L = [[e^A, 0], [C, e^B]]` (log-Cholesky of the inverse squared widths: smooth through the round lobe, positive definite):

    WARD            g = exp(-2 q / (1 + h·n)) e^(A+B) / (4 pi n·o)            Ward-Duer with its cosine
    BECKMANN        g = exp(-q / (h·n)²) G1(i) G1(o) e^(A+B) / (4 pi (h·n)⁴ n·o)  microfacets, Smith's G
    GGX             g = G1(i) G1(o) e^(A+B) / (4 pi (q + (h·n)²)² n·o)          microfacets with long tails, Smith's G
    PRINTED         g = exp(-2 q / (1 + h·n)) e^(A+B) / (4 pi sqrt((n·o)(n·i)))   PRF Eq. 14 without a cosine
    PRINTED_COSINE  the printed lobe times n·i

Derivatives are with respect to (d1, d2) = tilt of n along t and b, (A, B, C) and rho. G1 is the rational fit of
Walter et al. 2007, Eq. 27, as renderers use it; GGX's is exact (Heitz 2014). The loops only read and sum: that is what lets
them vectorise.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, FOUR, HALF, ONE, TINY, TWO, ZERO, exp
from pipeline.rig.lobe_names import BECKMANN, GGX, PRINTED, PRINTED_COSINE, WARD
from pipeline.rig.smith_fit import smith_fit

INVERSE_4PI = 1.0 / (4.0 * math.pi)
VIEW_FLOOR = 0.01  # n·o below it (0.6 degrees from grazing) is held there: 1/(n·o) would run away
LIGHT_FLOOR = np.float32(0.01)  # the same for n·i under the printed lobe's square root

G_ONE = np.float32(1 / 1.6)  # below this alpha tan(theta) nothing is masked


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _slope(x, y, z, ea, eb, c):
    """Slope of a direction (x, y, z) in units of the widths, and what its derivatives are made of."""
    fa, fb = ONE / ea, ONE / eb
    z = max(z, LIGHT_FLOOR)
    v0 = x * fa
    v1 = (y - c * v0) * fb
    square = v0 * v0 + v1 * v1 + TINY
    return math.sqrt(square) / z, square, v0, v1, fa, fb, z


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _masked(g, slope, square, v0, v1, fa, fb, c, x, y, z):
    """G1, and d log G1 by d1, d2, A, B, C from `slope`, its derivative by the logarithm of the direction's slope."""
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


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def smith(x, y, z, ea, eb, c):
    """Beckmann's G1 of a direction (x, y, z) in the frame, and d log G1 by d1, d2, A, B, C."""
    s, square, v0, v1, fa, fb, z = _slope(x, y, z, ea, eb, c)
    ga, gb, gc, gd = smith_fit(s)
    top, bottom = ga * s + gb, s * s + gc * s + gd
    below = s < G_ONE
    g = ONE if below else top / bottom
    slope = ZERO * s if below else (ga / top - (TWO * s + gc) / bottom) * s  # by log s
    return _masked(g, slope, square, v0, v1, fa, fb, c, x, y, z)


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def smith_ggx(x, y, z, ea, eb, c):
    """GGX's G1 of a direction (x, y, z) in the frame, and d log G1 by d1, d2, A, B, C."""
    s, square, v0, v1, fa, fb, z = _slope(x, y, z, ea, eb, c)
    root = math.sqrt(ONE + s * s)
    return _masked(TWO / (ONE + root), -s * s / (root * (ONE + root)), square, v0, v1, fa, fb, c, x, y, z)


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _point(h0, h1, h2, i0, i1, i2, f, ea, eb, c, kind):
    """Lobe of one light without its factor, and the derivatives of its logarithm by d1, d2, A, B, C.

    kind: (1 for Beckmann else 0, 1 - that, coefficients of 1, 1/sqrt(n·i), sqrt(n·i), the power of n·i). All lobes share one
    loop, blended by these numbers: a branch would be compiled into four loops.
    """
    x = f[0] * h0 + f[1] * h1 + f[2] * h2
    y = f[3] * h0 + f[4] * h1 + f[5] * h2
    z = f[6] * h0 + f[7] * h1 + f[8] * h2
    ix = f[0] * i0 + f[1] * i1 + f[2] * i2
    iy = f[3] * i0 + f[4] * i1 + f[5] * i2
    iz = f[6] * i0 + f[7] * i1 + f[8] * i2
    beckmann, ward, flat, inverse_root, root, power = kind
    u0, u1 = ea * x + c * y, eb * y
    q = u0 * u0 + u1 * u1
    z = max(z, LIGHT_FLOOR)  # h is 0 or behind for a light opposite the view: no lobe reaches there
    fz, fw = ONE / z, ONE / (ONE + z)
    i = beckmann * fz * fz + ward * TWO * fw  # exponent is -q i
    bend = TWO * q * i * (beckmann * fz + ward * HALF * fw) - beckmann * FOUR * fz  # by h·n, of the exponent and (h·n)^-4
    n = max(iz, LIGHT_FLOOR)
    s = math.sqrt(n)
    tail = flat + inverse_root / s + root * s
    g, s0, s1, s2, s3, s4 = smith(ix, iy, iz, ea, eb, c)
    g = ward * tail + beckmann * g * fz * fz * fz * fz
    i2 = TWO * i
    slope = power / n
    return (
        g * exp(-q * i),
        i2 * z * ea * u0 + bend * x + slope * ix + beckmann * s0,
        i2 * z * (c * u0 + eb * u1) + bend * y + slope * iy + beckmann * s1,
        ONE - i2 * ea * u0 * x + beckmann * s2,
        ONE - i2 * u1 * u1 + beckmann * s3,
        -i2 * u0 * y + beckmann * s4,
    )


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _ggx_point(h0, h1, h2, i0, i1, i2, f, ea, eb, c, kind):
    """The same of the GGX lobe, which has no exponential to share; `kind` is not used."""
    x = f[0] * h0 + f[1] * h1 + f[2] * h2
    y = f[3] * h0 + f[4] * h1 + f[5] * h2
    z = f[6] * h0 + f[7] * h1 + f[8] * h2
    ix = f[0] * i0 + f[1] * i1 + f[2] * i2
    iy = f[3] * i0 + f[4] * i1 + f[5] * i2
    iz = f[6] * i0 + f[7] * i1 + f[8] * i2
    u0, u1 = ea * x + c * y, eb * y
    z = max(z, LIGHT_FLOOR)
    fs = ONE / (u0 * u0 + u1 * u1 + z * z)
    g, s0, s1, s2, s3, s4 = smith_ggx(ix, iy, iz, ea, eb, c)
    k = FOUR * fs
    return (
        g * fs * fs,
        k * z * (ea * u0 - x) + s0,
        k * z * (c * u0 + eb * u1 - y) + s1,
        ONE - k * ea * u0 * x + s2,
        ONE - k * u1 * u1 + s3,
        -k * u0 * y + s4,
    )


def _loops(form, point):
    """The loops over a pixel's lights for one form of the lobe, compiled apart: a branch inside would not vectorise."""

    def compiled(function):
        function.__qualname__ = f"{function.__name__}_{form}"  # what it is kept on disk as
        return kernel(fastmath=FAST, error_model="numpy")(function)

    @compiled
    def values(h0, h1, h2, i0, i1, i2, f, ea, eb, c, kind, factor, out):
        for k in range(h0.size):
            out[k] = factor * point(h0[k], h1[k], h2[k], i0[k], i1[k], i2[k], f, ea, eb, c, kind)[0]

    @compiled
    def rows(h0, h1, h2, i0, i1, i2, f, ea, eb, c, kind, factor, v, out):
        for k in range(h0.size):
            g, l0, l1, l2, l3, l4 = point(h0[k], h1[k], h2[k], i0[k], i1[k], i2[k], f, ea, eb, c, kind)
            g *= factor
            out[0, k], out[1, k], out[2, k] = g * (l0 + v[0]), g * (l1 + v[1]), g * (l2 + v[2])
            out[3, k], out[4, k], out[5, k] = g * (l3 + v[3]), g * (l4 + v[4]), g

    @compiled
    def sums(h0, h1, h2, i0, i1, i2, light, floor, weight, f, ea, eb, c, kind, factor, rho, v, matrix, gradient):
        s00 = s01 = s02 = s03 = s04 = s05 = s11 = s12 = s13 = s14 = s15 = ZERO * ea
        s22 = s23 = s24 = s25 = s33 = s34 = s35 = s44 = s45 = s55 = ZERO * ea
        b0 = b1 = b2 = b3 = b4 = b5 = cost = ZERO * ea
        for k in range(light.size):
            g, l0, l1, l2, l3, l4 = point(h0[k], h1[k], h2[k], i0[k], i1[k], i2[k], f, ea, eb, c, kind)
            j5 = factor * g
            p = rho * j5
            r = p - light[k]
            r = r if floor[k] == ZERO else min(r, ZERO)
            w = weight[k]
            w = w if floor[k] == ZERO else (w if r < ZERO else ZERO)
            d = w * r
            cost += d * r
            j0, j1, j2, j3, j4 = p * (l0 + v[0]), p * (l1 + v[1]), p * (l2 + v[2]), p * (l3 + v[3]), p * (l4 + v[4])
            b0 += d * j0
            b1 += d * j1
            b2 += d * j2
            b3 += d * j3
            b4 += d * j4
            b5 += d * j5
            w0, w1, w2, w3, w4, w5 = w * j0, w * j1, w * j2, w * j3, w * j4, w * j5
            s00 += w0 * j0
            s01 += w0 * j1
            s02 += w0 * j2
            s03 += w0 * j3
            s04 += w0 * j4
            s05 += w0 * j5
            s11 += w1 * j1
            s12 += w1 * j2
            s13 += w1 * j3
            s14 += w1 * j4
            s15 += w1 * j5
            s22 += w2 * j2
            s23 += w2 * j3
            s24 += w2 * j4
            s25 += w2 * j5
            s33 += w3 * j3
            s34 += w3 * j4
            s35 += w3 * j5
            s44 += w4 * j4
            s45 += w4 * j5
            s55 += w5 * j5
        m, b = matrix, gradient
        b[0], b[1], b[2], b[3], b[4], b[5] = b0, b1, b2, b3, b4, b5
        m[0, 0], m[0, 1], m[0, 2], m[0, 3], m[0, 4], m[0, 5] = s00, s01, s02, s03, s04, s05
        m[1, 1], m[1, 2], m[1, 3], m[1, 4], m[1, 5] = s11, s12, s13, s14, s15
        m[2, 2], m[2, 3], m[2, 4], m[2, 5] = s22, s23, s24, s25
        m[3, 3], m[3, 4], m[3, 5], m[4, 4], m[4, 5], m[5, 5] = s33, s34, s35, s44, s45, s55
        return cost

    return values, rows, sums


_values, _rows, _sums = _loops("shared", _point)
_ggx_values, _ggx_rows, _ggx_sums = _loops("ggx", _ggx_point)


@kernel(error_model="numpy")
def _common(lobe, frame, shape, o, kind):
    """What all lights of a pixel share: the frame as 9 numbers, (e^A, e^B, C), the factor, and the view's derivatives."""
    ot = frame[0, 0] * o[0] + frame[0, 1] * o[1] + frame[0, 2] * o[2]
    ob = frame[1, 0] * o[0] + frame[1, 1] * o[1] + frame[1, 2] * o[2]
    on = frame[2, 0] * o[0] + frame[2, 1] * o[1] + frame[2, 2] * o[2]
    held = max(on, VIEW_FLOOR)
    free = 1.0 if on > VIEW_FLOOR else 0.0
    a, b, c = math.exp(shape[0]), math.exp(shape[1]), shape[2]
    factor = a * b * INVERSE_4PI / held
    v0, v1, v2, v3, v4 = -free * ot / held, -free * ob / held, 0.0, 0.0, 0.0
    if lobe in (PRINTED, PRINTED_COSINE):
        factor *= math.sqrt(held)
        v0, v1 = 0.5 * v0, 0.5 * v1
    elif lobe == BECKMANN:
        g, s0, s1, v2, v3, v4 = smith(ot, ob, held, a, b, c)
        factor *= g
        v0, v1 = v0 + s0, v1 + s1
    elif lobe == GGX:
        g, s0, s1, v2, v3, v4 = smith_ggx(ot, ob, held, a, b, c)
        factor *= g
        v0, v1 = v0 + s0, v1 + s1
    f = (kind(frame[0, 0]), kind(frame[0, 1]), kind(frame[0, 2]), kind(frame[1, 0]), kind(frame[1, 1]), kind(frame[1, 2]),
         kind(frame[2, 0]), kind(frame[2, 1]), kind(frame[2, 2]))  # fmt: skip
    beckmann = 1.0 if lobe == BECKMANN else 0.0
    flat = 1.0 if lobe == WARD else 0.0
    inverse_root = 1.0 if lobe == PRINTED else 0.0
    root = 1.0 if lobe == PRINTED_COSINE else 0.0
    blend = (
        kind(beckmann),
        kind(1.0 - beckmann),
        kind(flat),
        kind(inverse_root),
        kind(root),
        kind(0.5 * (root - inverse_root)),
    )
    return f, kind(a), kind(b), kind(c), blend, kind(factor), (kind(v0), kind(v1), kind(v2), kind(v3), kind(v4))


@kernel(error_model="numpy")
def values(lobe, frame, shape, o, h, i, out):
    """Evaluate a lobe over the lights of a pixel; device function.

    Args:
        lobe: WARD, BECKMANN or GGX.
        frame: rows t, b, n of the surface, world, float64. [3, 3]
        shape: A, B, C, the log-Cholesky factors of the inverse squared widths, float64. [3]
        o: unit, to the camera. [3]
        h, i: half vectors and directions to the lights, world, each as three contiguous arrays (which lets the loops
            vectorise). [N] each
        out: filled with g. [N]
    """
    f, a, b, c, blend, factor, _ = _common(lobe, frame, shape, o, h[0].dtype.type)
    if lobe == GGX:
        _ggx_values(h[0], h[1], h[2], i[0], i[1], i[2], f, a, b, c, blend, factor, out)
    else:
        _values(h[0], h[1], h[2], i[0], i[1], i[2], f, a, b, c, blend, factor, out)


@kernel(error_model="numpy")
def normal_equations(lobe, frame, shape, rho, o, h, i, light, floor, weight, matrix, gradient):
    """Compute the Gauss-Newton system of half the weighted square residual of `rho g`; device function.

    Args:
        lobe, frame, shape, o, h, i: as in `values`. [...]
        rho: specular albedo.
        light: measured radiance over irradiance. [N]
        floor: 1 where a sample is a lower bound (clipped) and counts only while the lobe stays below it, else 0. [N]
        weight: of the squared residuals. [N]
        matrix: filled, float64. [6, 6]
        gradient: filled, float64. [6]

    Returns:
        The cost.
    """
    kind = h[0].dtype.type
    f, a, b, c, blend, factor, v = _common(lobe, frame, shape, o, kind)
    if lobe == GGX:
        cost = _ggx_sums(h[0], h[1], h[2], i[0], i[1], i[2], light, floor, weight, f, a, b, c, blend, factor, kind(rho), v,
                         matrix, gradient)  # fmt: skip
    else:
        cost = _sums(h[0], h[1], h[2], i[0], i[1], i[2], light, floor, weight, f, a, b, c, blend, factor, kind(rho), v,
                     matrix, gradient)  # fmt: skip
    for row in range(6):
        for column in range(row):
            matrix[row, column] = matrix[column, row]
    return float(cost)


@kernel(error_model="numpy")
def jacobian(lobe, frame, shape, o, h, i, out):
    """Compute the derivatives of a lobe over the lights of a pixel; device function.

    Args:
        lobe, frame, shape, o, h, i: as in `values`. [...]
        out: filled with the derivatives of g by d1, d2, A, B, C, and g itself in the last row. [6, N]
    """
    f, a, b, c, blend, factor, v = _common(lobe, frame, shape, o, h[0].dtype.type)
    if lobe == GGX:
        _ggx_rows(h[0], h[1], h[2], i[0], i[1], i[2], f, a, b, c, blend, factor, v, out)
    else:
        _rows(h[0], h[1], h[2], i[0], i[1], i[2], f, a, b, c, blend, factor, v, out)
