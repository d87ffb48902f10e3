"""What a leaf of the tree of light adds to the sum of `light_tree_kernels`, with its derivatives (numba)."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

from .cube_kernels import MATH
from .facet_kernels import masking, masking_slopes, polarisation, reflectance, reflectance_slopes

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
    weight = d * masking(max(nl, _LEAST), a2, ggx) * reflectance(vh, e)
    return weight, h0, h1, h2, vh, nh, nl, sin2, wide


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
def lobe_slopes(nh, nl, vh, sin2, a2, e, ggx, variance):
    """Slopes of log(D G1 F) in n.h, n.l, v.h, alpha^2 and eta, with the spread of the light as in `lobe_weight`."""
    by_nh, by_a2, by_vh = _distribution_slopes(nh, vh, sin2, a2, ggx, variance)
    by_nl, masking_a2 = masking_slopes(max(nl, _LEAST), a2, ggx)
    fresnel_vh, by_e = reflectance_slopes(vh, e)
    return by_nh, by_nl if nl > _LEAST else _ZERO, by_vh + fresnel_vh, by_a2 + masking_a2, by_e


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
