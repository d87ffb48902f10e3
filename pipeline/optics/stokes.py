"""Linear Stokes vectors s = (s0, s1, s2) on the last axis, in radiance units; angles counter-clockwise from
the frame's x.

s1 = I(0) - I(90 deg), s2 = I(45 deg) - I(135 deg); a pixel's frame is x right, y up as the image is
displayed.
"""

from __future__ import annotations

from typing import Any

from array_api_compat import array_namespace

Array = Any


def degree(stokes: Array) -> Array:
    """Compute the degree of linear polarisation |(s1, s2)|/s0.

    Args:
        stokes: s0, s1, s2 on the last axis. [..., 3]

    Returns:
        >= 0; noise can take it above 1; 0 where s0 <= 0 or denormal. [...]
    """
    xp = array_namespace(stokes)
    s0, s1, s2 = stokes[..., 0], stokes[..., 1], stokes[..., 2]
    # Less than the smallest normal number is no light: the slope 1/s0 would overflow.
    lit, polarised = s0 >= xp.finfo(s0.dtype).smallest_normal, (s1 != 0) | (s2 != 0)
    # Divided first: the squares of faint light underflow. The length's slope is 0/0 without polarisation.
    one = xp.ones_like(s0)
    scale = xp.where(lit, s0, one)
    length = xp.hypot(xp.where(polarised, s1 / scale, one), s2 / scale)
    return xp.where(lit & polarised, length, xp.zeros_like(s0))


def angle(stokes: Array) -> Array:
    """Compute the angle of linear polarisation atan2(s2, s1)/2.

    Args:
        stokes: s0, s1, s2 on the last axis. [..., 3]

    Returns:
        Radians in (-pi/2, pi/2], counter-clockwise from the frame's x; 0 for unpolarised light. [...]
    """
    xp = array_namespace(stokes)
    return xp.atan2(stokes[..., 2], stokes[..., 1] + 0.0) / 2  # -0 + 0 is 0, where atan2 would say pi


def angle_difference(a: Array, b: Array) -> Array:
    """Smallest difference |a - b| of two polarisation angles, which repeat every pi (rad), in [0, pi/2]."""
    xp = array_namespace(a, b)
    d = xp.abs(a - b) % xp.pi
    return xp.minimum(d, xp.pi - d)


def polariser_row(theta: Array, extinction: float | Array = float("inf")) -> Array:
    """Row (1, k cos 2t, k sin 2t)/2 of a polariser's Mueller matrix seen by a sensor (PhyGaP Eq. 31), [...]
    -> [..., 3].

    theta: transmission axis (rad). extinction: ratio of the principal transmittances; k = (e-1)/(e+1), and
    the row is scaled so that the open transmittance stays 1 (an ideal polariser has e = inf, k = 1).
    """
    xp = array_namespace(theta)
    k = 1 - 2 / (extinction + 1)
    one = xp.ones_like(theta)
    return xp.stack((one, k * xp.cos(2 * theta), k * xp.sin(2 * theta)), axis=-1) / 2


def surface_pattern(normal: Array, frame_x: Array, frame_y: Array) -> tuple[Array, Array]:
    """Compute (nx^2 - ny^2, 2 nx ny) of a normal projected on a pixel's frame: sin^2(theta) (cos 2phi, sin 2phi).

    Times +beta_d/sin^2 it gives (s1, s2)/s0 of light from the body, times -beta_s/sin^2 of mirrored light.
    Source: PhyGaP Eqs. 7-8.

    Args:
        normal: unit. [..., 3]
        frame_x, frame_y: the pixel's Stokes axes, in the normal's coordinates, unit. [..., 3]

    Returns:
        The two terms. [...] each
    """
    xp = array_namespace(normal, frame_x, frame_y)
    x = xp.sum(normal * frame_x, axis=-1)
    y = xp.sum(normal * frame_y, axis=-1)
    return (x - y) * (x + y), 2 * x * y
