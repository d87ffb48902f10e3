"""The lobe that `light_tree_kernels` sums over, with its derivatives (numba): D, Smith's shadowing, Fresnel, polarisation."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

from .shade_kernels import MATH

_ZERO, _HALF, _ONE, _TWO, _FOUR = (np.float32(x) for x in (0, 0.5, 1, 2, 4))
_TINY = np.float32(1e-6)
_LEAST = np.float32(1e-4)  # cosine of the light below which its shadowing is taken as there: the slope of 1/cosine^2 is finite


@kernel(fastmath=MATH, error_model="numpy")
def lobe_weight(n, v, l, nv, a2, e, ggx, variance):
    """(weight D G1(l) F, h, v.h, n.h, n.l, sin^2, D's width) of light from l; weight 0 below the horizon.

    The light's own spread about l widens the lobe: variances of slopes add.
    """
    s0, s1, s2 = v[0] + l[0], v[1] + l[1], v[2] + l[2]
    nl = n[0] * l[0] + n[1] * l[1] + n[2] * l[2]
    square = max(s0 * s0 + s1 * s1 + s2 * s2, _TINY)
    inverse = _ONE / np.sqrt(square)
    h0, h1, h2 = s0 * inverse, s1 * inverse, s2 * inverse
    vh = _HALF * square * inverse
    nh = (nv + nl) * inverse
    c0, c1, c2 = n[1] * h2 - n[2] * h1, n[2] * h0 - n[0] * h2, n[0] * h1 - n[1] * h0
    sin2 = c0 * c0 + c1 * c1 + c2 * c2
    if nl <= _ZERO or nh <= _TINY:
        return _ZERO, h0, h1, h2, vh, nh, nl, sin2, a2
    slopes = variance * (_ONE + _ONE / (vh * vh)) * np.float32(0.125)
    cos2 = nh * nh
    if ggx:
        wide = a2
        inverse = _ONE / (a2 * cos2 + sin2)
        d = a2 * inverse * inverse
        d *= max(_ONE + slopes * cos2 * (np.float32(8) * sin2 - _FOUR * a2 * cos2) * inverse * inverse, _HALF)
    else:
        wide = a2 + _TWO * slopes
        d = np.exp(-sin2 / (cos2 * wide)) / (wide * cos2 * cos2)
    level = max(nl, _LEAST)
    t2 = (_ONE - level) * (_ONE + level) / (level * level)
    if ggx:
        g = _TWO / (_ONE + np.sqrt(_ONE + a2 * t2))
    else:
        a = _ONE / np.sqrt(max(a2 * t2, np.float32(1e-12)))
        g = _ONE
        if a < np.float32(1.6):
            top = _ONE - np.float32(1.259) * a + np.float32(0.396) * a * a
            g = _ONE / (_ONE + top / (np.float32(3.535) * a + np.float32(2.181) * a * a))
    k2 = (e - _ONE) * (e + _ONE)
    root = np.sqrt(k2 + vh * vh)
    x = k2 / ((vh + root) * (vh + root))
    e2 = e * e
    y = k2 * ((e2 + _ONE) * vh * vh - _ONE) / ((e2 * vh + root) * (e2 * vh + root))
    return d * g * (x * x + y * y), h0, h1, h2, vh, nh, nl, sin2, wide


@kernel(fastmath=MATH, error_model="numpy")
def polarisation(c, square, e):
    """beta_s/sin^2 with its slopes in c, square = sin^2, and eta."""
    q = np.sqrt((e - _ONE) * (e + _ONE) + c * c)
    x = c * q
    d = _ONE / (x * x + square * square)
    value = _TWO * x * d
    by_x = _TWO * d - value * _TWO * x * d
    return value, by_x * (q + c * c / q), -value * _TWO * square * d, by_x * c * e / q


@kernel(fastmath=MATH, error_model="numpy")
def _distribution_slopes(nh, vh, sin2, a2, ggx, variance):
    """Slopes of log D in n.h, alpha^2 and v.h (by which the spread of the light widens the lobe)."""
    cos2 = nh * nh
    slopes = variance * (_ONE + _ONE / (vh * vh)) * np.float32(0.125)
    by_spread = _ZERO
    if ggx:
        inverse = _ONE / (a2 * cos2 + sin2)
        by_nh = _FOUR * nh * (_ONE - a2) * inverse
        by_a2 = _ONE / a2 - _TWO * cos2 * inverse
        square = inverse * inverse
        lift = np.float32(8) * sin2 - _FOUR * a2 * cos2
        wider = _ONE + slopes * cos2 * lift * square
        if wider > _HALF:
            part = slopes / wider
            by_cos2 = lift * square - cos2 * (np.float32(8) + _FOUR * a2) * square
            by_cos2 -= _TWO * cos2 * lift * (a2 - _ONE) * square * inverse
            by_nh += part * by_cos2 * _TWO * nh
            by_a2 -= part * cos2 * cos2 * (_FOUR * square + _TWO * lift * square * inverse)
            by_spread = cos2 * lift * square / wider
    else:
        wide = a2 + _TWO * slopes
        by_nh = _TWO / (cos2 * nh * wide) - _FOUR / nh
        by_a2 = (sin2 / cos2 / wide - _ONE) / wide
        by_spread = _TWO * by_a2
    return by_nh, by_a2, -by_spread * variance * np.float32(0.25) / (vh * vh * vh)


@kernel(fastmath=MATH, error_model="numpy")
def _shadow_slopes(nl, a2, ggx):
    """Slopes of log G1(l) in n.l and alpha^2."""
    level = max(nl, _LEAST)
    t2 = (_ONE - level) * (_ONE + level) / (level * level)
    by_t2, by_a2 = _ZERO, _ZERO
    if ggx:
        root = np.sqrt(_ONE + a2 * t2)
        share = -_HALF / (root * (_ONE + root))
        by_t2, by_a2 = share * a2, share * t2
    else:
        a = _ONE / np.sqrt(max(a2 * t2, np.float32(1e-12)))
        if a < np.float32(1.6):
            top = _ONE - np.float32(1.259) * a + np.float32(0.396) * a * a
            low = _ONE / (np.float32(3.535) * a + np.float32(2.181) * a * a)
            lam = top * low
            slope = (np.float32(0.792) * a - np.float32(1.259)) * low
            slope -= lam * (np.float32(3.535) + np.float32(4.362) * a) * low
            by_log = _HALF * a * slope / (_ONE + lam)  # d log G / d log of alpha^2 and of tan^2
            by_a2 = by_log / a2
            by_t2 = by_log / max(t2, np.float32(1e-12))
    return -_TWO * by_t2 / (level * level * level) if nl > _LEAST else _ZERO, by_a2


@kernel(fastmath=MATH, error_model="numpy")
def _fresnel_slopes(vh, e):
    """Slopes of log F in v.h and eta."""
    k2 = (e - _ONE) * (e + _ONE)
    root = np.sqrt(k2 + vh * vh)
    e2 = e * e
    i, j = _ONE / (vh + root), _ONE / (e2 * vh + root)
    x = k2 * i * i
    face = (e2 + _ONE) * vh * vh - _ONE
    y = k2 * face * j * j
    share = _TWO / max(x * x + y * y, np.float32(1e-30))
    x_c, x_e = -_TWO * x / root, _TWO * e * i * i - _TWO * x * i * e / root
    y_c = k2 * _TWO * (e2 + _ONE) * vh * j * j - _TWO * y * j * (e2 + vh / root)
    y_e = _TWO * e * face * j * j + k2 * _TWO * e * vh * vh * j * j - _TWO * y * j * (_TWO * e * vh + e / root)
    return share * (x * x_c + y * y_c), share * (x * x_e + y * y_e)


@kernel(fastmath=MATH, error_model="numpy")
def lobe_slopes(nh, nl, vh, sin2, a2, e, ggx, variance):
    """Slopes of log(D G1 F) in n.h, n.l, v.h, alpha^2 and eta, with the spread of the light as in `lobe_weight`."""
    by_nh, by_a2, by_vh = _distribution_slopes(nh, vh, sin2, a2, ggx, variance)
    by_nl, shadow_a2 = _shadow_slopes(nl, a2, ggx)
    fresnel_vh, by_e = _fresnel_slopes(vh, e)
    return by_nh, by_nl, by_vh + fresnel_vh, by_a2 + shadow_a2, by_e


@kernel(fastmath=MATH, error_model="numpy")
def leaf_gradient(n, v, l, nv, a2, e, ggx, variance, share, x, y, r, a, b, c, mean):
    """What one leaf adds to the gradients: (normal 3, view 3, alpha^2, eta, its radiance 3).

    share: solid angle over the sum of weights; r: the leaf's radiance; a, b, c: gradients of the mirrored light and of its
    two polarised parts; mean: what they come to for the sums themselves.
    """
    w, h0, h1, h2, vh, nh, nl, sin2, _ = lobe_weight(n, v, l, nv, a2, e, ggx, variance)
    w *= share
    if w <= _ZERO:
        return _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    hx = h0 * x[0] + h1 * x[1] + h2 * x[2]
    hy = h0 * y[0] + h1 * y[1] + h2 * y[2]
    beta, beta_c, beta_s, beta_e = polarisation(vh, hx * hx + hy * hy, e)
    cos2, sin2_ = (hx - hy) * (hx + hy), _TWO * hx * hy
    along1, along2 = b[0] * r[0] + b[1] * r[1] + b[2] * r[2], c[0] * r[0] + c[1] * r[1] + c[2] * r[2]
    g_beta = w * (cos2 * along1 + sin2_ * along2)
    g_w = w * (a[0] * r[0] + a[1] * r[1] + a[2] * r[2] - mean) + beta * g_beta
    by_nh, by_nl, by_vh, by_a2, by_e = lobe_slopes(nh, nl, vh, sin2, a2, e, ggx, variance)
    g_x = _TWO * (w * beta * (along1 * hx + along2 * hy) + g_beta * beta_s * hx)
    g_y = _TWO * (w * beta * (along2 * hx - along1 * hy) + g_beta * beta_s * hy)
    g_nh, g_nl = g_w * by_nh, g_w * by_nl
    gh0 = g_nh * n[0] + g_x * x[0] + g_y * y[0]
    gh1 = g_nh * n[1] + g_x * x[1] + g_y * y[1]
    gh2 = g_nh * n[2] + g_x * x[2] + g_y * y[2]
    shorter = _HALF / vh
    lost = _HALF * (g_w * by_vh + g_beta * beta_c) - (gh0 * h0 + gh1 * h1 + gh2 * h2) * shorter
    return (
        g_nh * h0 + g_nl * l[0], g_nh * h1 + g_nl * l[1], g_nh * h2 + g_nl * l[2],
        gh0 * shorter + lost * h0, gh1 * shorter + lost * h1, gh2 * shorter + lost * h2,
        g_w * by_a2, g_w * by_e + g_beta * beta_e,
        w * (a[0] + beta * (cos2 * b[0] + sin2_ * c[0])),
        w * (a[1] + beta * (cos2 * b[1] + sin2_ * c[1])),
        w * (a[2] + beta * (cos2 * b[2] + sin2_ * c[2])),
    )  # fmt: skip
