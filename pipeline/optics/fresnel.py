"""Fresnel reflection and transmission of a dielectric, in forms that neither cancel nor divide by a
vanishing sine.

Everywhere `c` = cosine between the direction and the surface normal (> 0), `sin2` = its squared sine, taken
from the projected normal where there is one (`1 - c*c` loses all digits near normal incidence), `eta` =
index of refraction >= 1. All functions are elementwise, broadcast, and accept numpy, torch or jax arrays of
float32 or float64.
"""

from __future__ import annotations

import math
from typing import Any

from array_api_compat import array_namespace

Array = Any

# Below this cosine eta = 1 gives 0/0 (q = c there); its square is still a normal float32.
MIN_COSINE = 1e-6

# (1 - A0/pi)/(eta - 1) as a polynomial in sqrt(eta - 1), lowest order first: A0 has a term (eta - 1)^2 log(eta - 1), which no
# polynomial in eta follows. Least largest error (reweighted) against the closed form at 60 digits.
HEMISPHERICAL_RANGE = (1.0, 2.6)
HEMISPHERICAL_STEP = 2 / math.sqrt(HEMISPHERICAL_RANGE[1] - HEMISPHERICAL_RANGE[0])
HEMISPHERICAL = (
    0.192029411,
    -0.0785995242,
    0.0622623378,
    -0.0398934184,
    0.00527308817,
    0.0111149934,
    -0.0113074804,
    0.0100064142,
    -0.00762897546,
    0.00253939666,
)
MIN_EXCESS = 1e-12  # eta - 1 whose root still has a finite slope; squares of the root's error are lost in 1


def _floor(c: Array, eta: Array) -> tuple[Any, Array]:
    xp = array_namespace(c, eta)
    return xp, xp.clip(c, MIN_COSINE, None)


def _refracted(xp: Any, c: Array, eta: Array) -> Array:
    """q = eta cos(theta_t) = sqrt((eta-1)(eta+1) + c^2): Snell's law without sines."""
    return xp.sqrt((eta - 1) * (eta + 1) + c * c)


def normal_reflectance(eta: Array) -> Array:
    """Compute F0 = ((eta-1)/(eta+1))^2 (PhyGaP Eq. 18).

    Args:
        eta: index of refraction.

    Returns:
        Reflectance at normal incidence, elementwise.
    """
    f = (eta - 1) / (eta + 1)
    return f * f


def schlick(c: Array, eta: Array) -> Array:
    """Compute Schlick's approximation of the unpolarised reflectance (Schlick 1994, as PhyGaP has it).

    Args:
        c: cosine of incidence, clipped to [0, 1], outside which the formula exceeds 1.
        eta: index of refraction.

    Returns:
        0..1, elementwise.
    """
    xp = array_namespace(c, eta)
    m = 1 - xp.clip(c, 0.0, 1.0)
    m2 = m * m
    f0 = normal_reflectance(eta)
    return f0 + (1 - f0) * (m2 * m2 * m)


def amplitudes(c: Array, eta: Array) -> tuple[Array, Array]:
    """Fresnel's amplitudes (-r_s, r_p): real, since total reflection does not occur from outside.

    Their differences are factored: c - q = -(eta^2-1)/(c+q), so both vanish exactly at eta = 1, and r_p keeps its digits in
    front of Brewster's angle, where it changes sign.
    """
    xp, c = _floor(c, eta)
    q = _refracted(xp, c, eta)
    k = (eta - 1) * (eta + 1)
    e2 = eta * eta
    return k / ((c + q) * (c + q)), (k * ((e2 + 1) * c * c - 1)) / ((e2 * c + q) * (e2 * c + q))


def reflectances(c: Array, eta: Array) -> tuple[Array, Array]:
    """Compute the exact power reflectances (Fresnel).

    Args:
        c: cosine of incidence, floored at MIN_COSINE.
        eta: index of refraction, >= 1.

    Returns:
        R_s and R_p, across and in the plane of incidence, elementwise; R_p is 0 at Brewster's angle.
    """
    s, p = amplitudes(c, eta)
    return s * s, p * p


def reflectance(c: Array, eta: Array) -> Array:
    """Compute the exact unpolarised power reflectance F = (R_s + R_p)/2 (Fresnel).

    Args:
        c: cosine of incidence, floored at MIN_COSINE.
        eta: index of refraction, >= 1.

    Returns:
        0..1, elementwise.
    """
    s, p = reflectances(c, eta)
    return (s + p) / 2


def transmittances(c: Array, eta: Array) -> tuple[Array, Array]:
    """Exact power transmittances (1 - R_s, 1 - R_p), computed without the subtraction (PhyGaP Eq. 26)."""
    xp, c = _floor(c, eta)
    q = _refracted(xp, c, eta)
    e2 = eta * eta
    x = 4 * c * q
    return x / ((c + q) * (c + q)), x * e2 / ((e2 * c + q) * (e2 * c + q))


def transmittance(c: Array, eta: Array) -> Array:
    """Compute the exact unpolarised power transmittance T = 1 - F (Fresnel; PhyGaP Eq. 26).

    Args:
        c: cosine of incidence, floored at MIN_COSINE.
        eta: index of refraction, >= 1.

    Returns:
        0..1, elementwise.
    """
    s, p = transmittances(c, eta)
    return (s + p) / 2


def specular_polarisation(c: Array, sin2: Array, eta: Array) -> Array:
    """Compute beta_s / sin^2(theta), beta_s = (R_s - R_p)/(R_s + R_p) of mirrored light.

    beta_s is 1 at Brewster's angle tan(theta) = eta. With the normal's projection (nx, ny) on the pixel's
    frame: (s1, s2) = -beta_s/sin^2 (nx^2 - ny^2, 2 nx ny) L_s.
    Source: PhyGaP Eqs. 22-23, in docs/physics.md's stable form.

    Args:
        c: cosine of view and normal, floored at MIN_COSINE.
        sin2: squared sine of the same angle.
        eta: index of refraction, >= 1.

    Returns:
        >= 0, elementwise.
    """
    xp, c = _floor(c, eta)
    q = _refracted(xp, c, eta)
    x = c * q
    return 2 * x / (x * x + sin2 * sin2)


def diffuse_polarisation(c: Array, eta: Array) -> Array:
    """Compute beta_d / sin^2(theta), beta_d = (T_p - T_s)/(T_p + T_s) of light leaving the body.

    (s1, s2) = +beta_d/sin^2 (nx^2 - ny^2, 2 nx ny) L_d. Source: PhyGaP Eqs. 24-25, in docs/physics.md's stable form.

    Args:
        c: cosine of view and normal, floored at MIN_COSINE.
        eta: index of refraction, >= 1.

    Returns:
        >= 0, elementwise.
    """
    xp, c = _floor(c, eta)
    q = _refracted(xp, c, eta)
    a = (eta - 1) * (eta + 1) / eta
    b = eta + 1 / eta
    return a * a / (b * b * c * c + a * b + 4 * c * q)


def hemispherical_transmittance(eta: Array) -> Array:
    """Compute A0/pi = 2 * integral of T(c) c dc over [0, 1]: the share of a constant sky's light that enters the body.

    Walsh's closed form has logarithms; here 1 - (eta - 1) Q(sqrt(eta - 1)) with a polynomial Q: within 6e-7 on eta in [1, 2.6],
    and its slope within 5e-5 from eta = 1.25 on (2e-3 at 1).

    Args:
        eta: index of refraction, clipped to [1, 2.6].

    Returns:
        0..1, elementwise.
    """
    xp = array_namespace(eta)
    excess = xp.clip(eta, *HEMISPHERICAL_RANGE) - 1
    x = xp.sqrt(xp.clip(excess, MIN_EXCESS, None)) * HEMISPHERICAL_STEP - 1
    value = 0 * x + HEMISPHERICAL[-1]
    for coefficient in HEMISPHERICAL[-2::-1]:
        value = value * x + coefficient
    return 1 - excess * value
