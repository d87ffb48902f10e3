"""The lobes at one light, with the derivatives of their logarithms: what the loops over a pixel's lights evaluate.

See `lobes` for the formulas. The functions are inlined into the loops of `lobe_loops`.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, FOUR, HALF, ONE, TINY, TWO, ZERO, exp
from pipeline.rig.smith_fit import smith_fit

LIGHT_FLOOR = np.float32(0.01)  # n·i below it is held there under the printed lobe's square root

G_ONE = np.float32(1 / 1.6)  # below this alpha tan(theta) nothing is masked


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _in_frame(f, x, y, z):
    """A direction in the frame whose rows [9] are t, b, n."""
    return f[0] * x + f[1] * y + f[2] * z, f[3] * x + f[4] * y + f[5] * z, f[6] * x + f[7] * y + f[8] * z


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
def shared_point(h0, h1, h2, i0, i1, i2, f, ea, eb, c, kind):
    """Lobe of one light without its factor, and the derivatives of its logarithm by d1, d2, A, B, C.

    kind: (1 for Beckmann else 0, 1 - that, coefficients of 1, 1/sqrt(n·i), sqrt(n·i), the power of n·i). All lobes share one
    loop, blended by these numbers: a branch would be compiled into four loops.
    """
    x, y, z = _in_frame(f, h0, h1, h2)
    ix, iy, iz = _in_frame(f, i0, i1, i2)
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
def ggx_point(h0, h1, h2, i0, i1, i2, f, ea, eb, c, kind):
    """The same of the GGX lobe, which has no exponential to share; `kind` is not used."""
    x, y, z = _in_frame(f, h0, h1, h2)
    ix, iy, iz = _in_frame(f, i0, i1, i2)
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
