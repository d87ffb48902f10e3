"""The optics' functions as textbooks print them, at 60 digits (mpmath): nothing here is arranged for stability."""

from __future__ import annotations

import mpmath
from mpmath import mpf

Value = mpf
DIGITS = 60


def amplitudes(c: Value, eta: Value) -> tuple[Value, Value]:
    """Fresnel's amplitudes (r_s, r_p), outside to inside."""
    ct = mpmath.sqrt(1 - (1 - c * c) / eta**2)
    if c == 0 and ct == 0:
        return mpf(0), mpf(0)
    return (c - eta * ct) / (c + eta * ct), (eta * c - ct) / (eta * c + ct)


def opposed_amplitudes(c: Value, eta: Value) -> tuple[Value, Value]:
    """(-r_s, r_p)."""
    s, p = amplitudes(c, eta)
    return -s, p


def powers(c: Value, eta: Value) -> tuple[Value, Value]:
    """(R_s, R_p)."""
    s, p = amplitudes(c, eta)
    return s * s, p * p


def schlick(c: Value, eta: Value) -> Value:
    """F0 + (1 - F0)(1 - c)^5."""
    f0 = ((eta - 1) / (eta + 1)) ** 2
    return f0 + (1 - f0) * (1 - c) ** 5


def specular_polarisation(c: Value, sin2: Value, eta: Value) -> Value:
    """(R_s - R_p)/(R_s + R_p)/sin^2 with the sine as an argument: 2 c q/(c^2 q^2 + sin^4), exact for sin^2 = 1 - c^2."""
    q = mpmath.sqrt(eta**2 - 1 + c * c)
    return 2 * c * q / (c * c * q * q + sin2 * sin2)


def diffuse_polarisation(c: Value, eta: Value) -> Value:
    """(T_p - T_s)/(T_p + T_s)/sin^2; taken just beside c, since it is 0/0 at normal incidence."""
    c = c - mpf("1e-25")
    s, p = powers(c, eta)
    return (s - p) / (2 - s - p) / (1 - c * c)


def hemispherical_transmittance(eta: Value) -> Value:
    """2 int T c dc in closed form (Walsh 1926), 1 at eta = 1."""
    n = eta
    if n == 1:
        return mpf(1)
    reflected = (
        mpf(1) / 2
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * mpmath.log((n - 1) / (n + 1))
        - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * mpmath.log(n)
    )
    return 1 - reflected


def ggx_distribution(nh: Value, alpha: Value) -> Value:
    """alpha^2/(pi cos^4 (alpha^2 + tan^2)^2)."""
    tan2 = (1 - nh**2) / nh**2
    return alpha**2 / (mpmath.pi * nh**4 * (alpha**2 + tan2) ** 2)


def beckmann_distribution(nh: Value, alpha: Value) -> Value:
    """exp(-tan^2/alpha^2)/(pi alpha^2 cos^4)."""
    return mpmath.exp(-(1 - nh**2) / nh**2 / alpha**2) / (mpmath.pi * alpha**2 * nh**4)


def ggx_lambda(c: Value, alpha: Value) -> Value:
    """(sqrt(1 + alpha^2 tan^2) - 1)/2."""
    return (mpmath.sqrt(1 + alpha**2 * (1 - c * c) / c**2) - 1) / 2


def beckmann_lambda(c: Value, alpha: Value) -> Value:
    """Closed form with the error function (not its rational fit)."""
    tan = mpmath.sqrt(1 - c * c) / c
    if tan == 0:
        return mpf(0)
    a = 1 / (alpha * tan)
    return mpmath.exp(-a * a) / (2 * a * mpmath.sqrt(mpmath.pi)) - mpmath.erfc(a) / 2


def beckmann_fit(c: Value, alpha: Value) -> Value:
    """Walter et al. 2007's fit of the above, as printed."""
    tan = mpmath.sqrt(1 - c * c) / c
    if tan == 0:
        return mpf(0)
    a = 1 / (alpha * tan)
    if a >= mpf("1.6"):
        return mpf(0)
    return (1 - mpf("1.259") * a + mpf("0.396") * a * a) / (mpf("3.535") * a + mpf("2.181") * a * a)


def degree(s0: Value, s1: Value, s2: Value) -> Value:
    """|(s1, s2)|/s0, 0 without light."""
    return mpmath.sqrt(s1**2 + s2**2) / s0 if s0 > 0 else mpf(0)


def angle(s0: Value, s1: Value, s2: Value) -> Value:
    """atan2(s2, s1)/2."""
    return mpmath.atan2(s2, s1) / 2 if s1 != 0 or s2 != 0 else mpf(0)


def angle_difference(a: Value, b: Value) -> Value:
    """Distance of a - b from the nearest multiple of pi."""
    return abs(a - b - mpmath.nint((a - b) / mpmath.pi) * mpmath.pi)


def contrast(extinction: Value) -> Value:
    """(e - 1)/(e + 1)."""
    return mpf(1) if mpmath.isinf(extinction) else (extinction - 1) / (extinction + 1)


def polariser(theta: Value, extinction: Value) -> tuple[Value, ...]:
    """Mueller matrix R(-theta) diag-attenuator R(theta), row by row; open transmittance 1."""
    k = contrast(extinction)
    c, s = mpmath.cos(2 * theta), mpmath.sin(2 * theta)
    cross = mpmath.sqrt(1 - k * k)
    rows = (
        (1, k * c, k * s),
        (k * c, c * c + s * s * cross, c * s * (1 - cross)),
        (k * s, c * s * (1 - cross), s * s + c * c * cross),
    )
    return tuple(mpf(x) / 2 for row in rows for x in row)


def rotation(phi: Value) -> tuple[Value, ...]:
    """The same light in a turned frame."""
    c, s = mpmath.cos(2 * phi), mpmath.sin(2 * phi)
    return tuple(mpf(x) for x in (1, 0, 0, 0, c, s, 0, -s, c))


def diattenuator(parallel: Value, perpendicular: Value, cross: Value) -> tuple[Value, ...]:
    """Mueller matrix with x in the plane of incidence."""
    mean, half = (parallel + perpendicular) / 2, (parallel - perpendicular) / 2
    return tuple(mpf(x) for x in (mean, half, 0, half, mean, 0, 0, 0, cross))


def reflection(c: Value, eta: Value) -> tuple[Value, ...]:
    """Mirror reflection, r_p and r_s with one handedness before and after."""
    s, p = amplitudes(c, eta)
    return diattenuator(p * p, s * s, s * p)


def transmission(c: Value, eta: Value) -> tuple[Value, ...]:
    """Power transmission."""
    s, p = powers(c, eta)
    return diattenuator(1 - p, 1 - s, mpmath.sqrt((1 - s) * (1 - p)))
