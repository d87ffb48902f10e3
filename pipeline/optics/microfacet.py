"""Isotropic microfacet lobes: distribution D and Smith shadowing G of GGX and Beckmann, alpha = r^2.

`nh`, `nv`, `nl`: cosines between the normal and half vector, view and light; all elementwise over numpy,
torch, jax.
"""

from __future__ import annotations

from math import erfc, exp, pi, sqrt
from typing import Any

from array_api_compat import array_namespace

Array = Any

# PhyGaP's smallest perceptual roughness: alpha = 0.0064, a lobe about 1 degree
# wide.
MIN_ROUGHNESS = 0.08

# Walter et al. 2007's fit of Beckmann's Lambda in a = 1/(alpha tan): (1 - A a + B a^2)/(C a + D a^2), nothing from END on.
BECKMANN_FIT = (1.259, 0.396, 3.535, 2.181)
BECKMANN_FIT_END = 1.6


def ggx_distribution(nh: Array, alpha: Array) -> Array:
    """GGX D(h) (1/sr): integral of D (n.h) over the hemisphere is 1. Written with tan^2 so small alpha does
    not cancel."""
    c2 = nh * nh
    a2 = alpha * alpha
    k = (1 - nh) * (1 + nh) + a2 * c2
    return a2 / (pi * k * k)


def beckmann_distribution(nh: Array, alpha: Array) -> Array:
    """Beckmann D(h) (1/sr): exp(-tan^2/alpha^2) / (pi alpha^2 cos^4)."""
    xp = array_namespace(nh, alpha)
    c2 = nh * nh
    # The exponent's slope overflows before the exponential's 0 can take it back where its reciprocals are squared.
    steep = 1 / (nh * alpha)
    return xp.exp(-((1 - nh) * (1 + nh) * steep) * steep) * (steep * steep) / (pi * c2)


def ggx_lambda(c: Array, alpha: Array) -> Array:
    """Smith's Lambda of GGX for a direction of cosine c > 0."""
    xp = array_namespace(c, alpha)
    tan2 = (1 - c) * (1 + c) / (c * c)
    x = alpha * alpha * tan2
    return x / (2 * (1 + xp.sqrt(1 + x)))


def beckmann_lambda(c: Array, alpha: Array) -> Array:
    """Smith's Lambda of Beckmann, Walter et al. 2007's rational fit (0.35 % of the exact form), c > 0."""
    xp = array_namespace(c, alpha)
    # The floor only moves a from infinity to 1e6/alpha, where Lambda is 0, and keeps the root's slope finite.
    tan = xp.sqrt(xp.clip((1 - c) * (1 + c), 1e-12, None)) / c
    a = 1 / (alpha * tan)
    one, two, three, four = BECKMANN_FIT
    fit = (1 - one * a + two * a * a) / (three * a + four * a * a)
    return xp.where(a < BECKMANN_FIT_END, fit, 0 * fit)


def beckmann_lambda_exact(c: float, alpha: float) -> float:
    """Smith's Lambda of Beckmann in closed form (erf), scalars only: the definition behind the fit."""
    tan = sqrt(max(0.0, 1 - c * c)) / c
    if tan == 0:
        return 0.0
    a = 1 / (alpha * tan)
    return exp(-a * a) / (2 * a * sqrt(pi)) - erfc(a) / 2


DISTRIBUTIONS = {"ggx": ggx_distribution, "beckmann": beckmann_distribution}
LAMBDAS = {"ggx": ggx_lambda, "beckmann": beckmann_lambda}


def masking(c: Array, alpha: Array, lobe: str = "ggx") -> Array:
    """Compute Smith's G1 = 1 / (1 + Lambda) for one direction (Walter et al. 2007).

    Args:
        c: cosine of the direction and the normal, > 0.
        alpha: width of the lobe.
        lobe: of `LAMBDAS`.

    Returns:
        0..1, elementwise.
    """
    return 1 / (1 + LAMBDAS[lobe](c, alpha))


def separable_shadowing(nv: Array, nl: Array, alpha: Array, lobe: str = "ggx") -> Array:
    """Compute Smith's separable shadowing G = G1(v) G1(l), as in Mitsuba's microfacet plugins.

    Args:
        nv, nl: cosines of view and light with the normal, > 0.
        alpha: width of the lobe.
        lobe: of `LAMBDAS`.

    Returns:
        0..1, elementwise.
    """
    return masking(nv, alpha, lobe) * masking(nl, alpha, lobe)
