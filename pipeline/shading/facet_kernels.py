"""What one facet of a rough mirror does, with slopes (numba, float32): Smith's masking, Fresnel reflectance, polarisation.

Definitions: `pipeline.optics.microfacet` and `fresnel`. The sums over facets (`lobe`, `light_tree_lobe`) share these.
"""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.optics.microfacet import BECKMANN_FIT, BECKMANN_FIT_END

from .cube_kernels import MATH

_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0, 0.5, 1, 2))
_FIT_A, _FIT_B, _FIT_C, _FIT_D = (np.float32(x) for x in BECKMANN_FIT)
_FIT_END = np.float32(BECKMANN_FIT_END)
_LEAST = np.float32(1e-12)  # of alpha^2 tan^2: nothing is masked there, and 1/tan stays finite


@kernel(fastmath=MATH, error_model="numpy")
def _beckmann(a2, t2):
    """Beckmann's Lambda of alpha^2 and tan^2, and its slope in the log of a = 1/(alpha tan)."""
    a = _ONE / np.sqrt(max(a2 * t2, _LEAST))
    if a >= _FIT_END:
        return _ZERO, _ZERO
    low = _ONE / (_FIT_C * a + _FIT_D * a * a)
    value = (_ONE - _FIT_A * a + _FIT_B * a * a) * low
    return value, a * low * (_TWO * _FIT_B * a - _FIT_A - value * (_FIT_C + _TWO * _FIT_D * a))


@kernel(fastmath=MATH, error_model="numpy")
def masking(c, a2, ggx):
    """Smith's G1 of a direction's cosine c > 0 and alpha^2."""
    t2 = (_ONE - c) * (_ONE + c) / (c * c)
    if ggx:
        return _TWO / (_ONE + np.sqrt(_ONE + a2 * t2))
    return _ONE / (_ONE + _beckmann(a2, t2)[0])


@kernel(fastmath=MATH, error_model="numpy")
def masking_slopes(c, a2, ggx):
    """Slopes of log G1 in the cosine and in alpha^2."""
    t2 = (_ONE - c) * (_ONE + c) / (c * c)
    if ggx:
        root = np.sqrt(_ONE + a2 * t2)
        share = -_HALF / (root * (_ONE + root))
        by_t2, by_a2 = share * a2, share * t2
    else:
        value, slope = _beckmann(a2, t2)
        by_log = _HALF * slope / (_ONE + value)  # d log G1 / d log of alpha^2, and of tan^2
        by_t2, by_a2 = by_log / max(t2, _LEAST), by_log / a2
    return -_TWO * by_t2 / (c * c * c), by_a2


@kernel(fastmath=MATH, error_model="numpy")
def reflectance(c, e):
    """R_s + R_p of unpolarised light at cosine c: twice Fresnel's F. Weights that are divided by their sum need no half."""
    k2 = (e - _ONE) * (e + _ONE)
    root = np.sqrt(k2 + c * c)
    e2 = e * e
    x = k2 / ((c + root) * (c + root))
    y = k2 * ((e2 + _ONE) * c * c - _ONE) / ((e2 * c + root) * (e2 * c + root))
    return x * x + y * y


@kernel(fastmath=MATH, error_model="numpy")
def reflectance_slopes(c, e):
    """Slopes of log F in the cosine and eta."""
    k2 = (e - _ONE) * (e + _ONE)
    root = np.sqrt(k2 + c * c)
    e2 = e * e
    i, j = _ONE / (c + root), _ONE / (e2 * c + root)
    x = k2 * i * i
    face = (e2 + _ONE) * c * c - _ONE
    y = k2 * face * j * j
    share = _TWO / max(x * x + y * y, np.float32(1e-30))
    x_c, x_e = -_TWO * x / root, _TWO * e * i * i - _TWO * x * i * e / root
    y_c = k2 * _TWO * (e2 + _ONE) * c * j * j - _TWO * y * j * (e2 + c / root)
    y_e = _TWO * e * face * j * j + k2 * _TWO * e * c * c * j * j - _TWO * y * j * (_TWO * e * c + e / root)
    return share * (x * x_c + y * y_c), share * (x * x_e + y * y_e)


@kernel(fastmath=MATH, error_model="numpy")
def polarisation(c, square, e):
    """beta_s/sin^2 with its slopes in c, square = sin^2, and eta."""
    q = np.sqrt((e - _ONE) * (e + _ONE) + c * c)
    x = c * q
    d = _ONE / (x * x + square * square)
    value = _TWO * x * d
    by_x = _TWO * d - value * _TWO * x * d
    return value, by_x * (q + c * c / q), -value * _TWO * square * d, by_x * c * e / q
