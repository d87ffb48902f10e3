"""Mueller matrices [..., 3, 3] for linear polarisation; frames as in `stokes` (x, y, propagation
right-handed for the viewer)."""

from __future__ import annotations

from typing import Any

from array_api_compat import array_namespace

from .fresnel import amplitudes, transmittances
from .stokes import polariser_row

Array = Any


def _matrix(xp: Any, rows: tuple[tuple[Array, ...], ...]) -> Array:
    return xp.stack(tuple(xp.stack(row, axis=-1) for row in rows), axis=-2)


def rotation(phi: Array) -> Array:
    """The same light described in a frame turned by +phi (rad, counter-clockwise): `rotation(phi) @ s`."""
    xp = array_namespace(phi)
    c, s, zero = xp.cos(2 * phi), xp.sin(2 * phi), xp.zeros_like(phi)
    return _matrix(xp, ((zero + 1, zero, zero), (zero, c, s), (zero, -s, c)))


def polariser(theta: Array, extinction: float | Array = float("inf")) -> Array:
    """Linear polariser with transmission axis theta (rad) and extinction ratio (principal transmittances 1
    and 1/e, scaled)."""
    xp = array_namespace(theta)
    first = polariser_row(theta, extinction)
    # Geometric mean of the principal transmittances sqrt(1 - k^2)/2, relative to their mean: 0 for an ideal polariser.
    root = extinction**0.5
    g = 1 / (root + 1 / root) + 0 * theta
    c, s = xp.cos(2 * theta), xp.sin(2 * theta)
    a, b, half = first[..., 1], first[..., 2], first[..., 0]
    return _matrix(
        xp,
        (
            (half, a, b),
            (a, c * c * half + s * s * g, c * s * (half - g)),
            (b, c * s * (half - g), s * s * half + c * c * g),
        ),
    )


def _diattenuator(parallel: Array, perpendicular: Array, cross: Array) -> Array:
    """Mueller matrix in the frame whose x axis lies in the plane of incidence; cross: product of the two
    amplitudes."""
    xp = array_namespace(parallel, perpendicular)
    mean, half = (parallel + perpendicular) / 2, (parallel - perpendicular) / 2
    zero = xp.zeros_like(mean)
    return _matrix(xp, ((mean, half, zero), (half, mean, zero), (zero, zero, cross)))


def reflection(c: Array, eta: Array) -> Array:
    """Dielectric mirror reflection; x of both frames in the plane of incidence, y equal in both.

    s1 of reflected unpolarised light is negative: it is polarised across the plane of incidence. Amplitudes
    are real outside total reflection; r_p r_s < 0 below Brewster's angle with these frames' handedness.
    """
    s, p = amplitudes(c, eta)
    return _diattenuator(p * p, s * s, -s * p)


def transmission(c: Array, eta: Array) -> Array:
    """Power transmission through the surface, c the cosine outside; frames as in `reflection`."""
    xp = array_namespace(c, eta)
    s, p = transmittances(c, eta)
    return _diattenuator(p, s, xp.sqrt(s * p))
