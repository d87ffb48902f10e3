"""Lens models: from a ray of the camera's frame to a point of its image, and back.

Image points are normalised: pixels less the principal point over the focal lengths. Names, coefficients and their order
are COLMAP's (and OpenCV's, where it has the model): SIMPLE_RADIAL and RADIAL are OPENCV with zeros, SIMPLE_RADIAL_FISHEYE
and RADIAL_FISHEYE are OPENCV_FISHEYE with zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Coefficients = Sequence[float]

PERSPECTIVE_REACH = np.radians(89.5)
"""Off the axis; a plane shows no more than 90 degrees."""
TINY = 1e-12


@dataclass(frozen=True)
class LensModel:
    """`names` of the coefficients in order; `project`: rays [..., 3] of the camera's frame to image points [..., 2] (NaN
    where the model has none); `reach`: the angle off the axis (rad) that its formula is meant for."""

    names: tuple[str, ...]
    project: Callable[[Array, Coefficients], Array]
    reach: float


def opencv(rays: Array, coefficients: Coefficients) -> Array:
    """Brown's lens with OpenCV's rational radial term: (k1 k2 p1 p2 k3 k4 k5 k6), as many as are given."""
    return brown(_plane(rays), coefficients)


def brown(ideal: Array, coefficients: Coefficients) -> Array:
    """Where Brown's lens (see `opencv`) puts the image points [..., 2] of a pinhole."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *(0.0,) * 8)[:8]
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    if k3 or k4 or k5 or k6:
        radial = (radial + k3 * r2**3) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    tangential = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1)
    return np.asarray(ideal * radial[..., None] + tangential)


def fov(rays: Array, coefficients: Coefficients) -> Array:
    """Devernay and Faugeras's field-of-view lens (2001): (omega)."""
    ideal, omega = _plane(rays), coefficients[0]
    radius = np.linalg.norm(ideal, axis=-1, keepdims=True)
    if abs(omega) < TINY:
        return ideal
    grown = np.arctan(2 * radius * np.tan(omega / 2)) / omega
    return np.asarray(ideal * np.where(radius > TINY, grown / np.maximum(radius, TINY), 2 * np.tan(omega / 2) / omega))


def division(rays: Array, coefficients: Coefficients) -> Array:
    """Fitzgibbon's division lens (2001): ideal = bent / (1 + k |bent|²): (k)."""
    ideal = _plane(rays)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1 - 4 * coefficients[0] * (ideal**2).sum(-1, keepdims=True))
    return np.asarray(ideal * 2 / (1 + root))


def eucm(rays: Array, coefficients: Coefficients) -> Array:
    """The enhanced unified camera model of Khomutenko et al. (2016): (alpha, beta)."""
    alpha, beta = coefficients
    distance = np.sqrt(beta * (rays[..., 0] ** 2 + rays[..., 1] ** 2) + rays[..., 2] ** 2)
    depth = alpha * distance + (1 - alpha) * rays[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = rays[..., :2] / depth[..., None]
    return np.where(depth[..., None] > TINY * distance[..., None], points, np.nan)


def fisheye(rays: Array, coefficients: Coefficients) -> Array:
    """Kannala and Brandt's lens (2006), OpenCV's fisheye: radius θ (1 + k1 θ² + k2 θ⁴ + ...)."""
    equidistant, theta = _equidistant(rays)
    return np.asarray(equidistant * _polynomial(theta**2, coefficients)[..., None])


def thin_prism_fisheye(rays: Array, coefficients: Coefficients) -> Array:
    """Weng et al.'s terms (1992) on an equidistant fisheye: (k1 k2 p1 p2 k3 k4 sx1 sy1)."""
    k1, k2, p1, p2, k3, k4, sx1, sy1 = coefficients
    point, theta = _equidistant(rays)
    x, y, r2 = point[..., 0], point[..., 1], theta**2
    radial = _polynomial(r2, (k1, k2, k3, k4))
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + sx1 * r2
    bent_y = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y) + sy1 * r2
    return np.stack([bent_x, bent_y], -1)


def rad_tan_thin_prism_fisheye(rays: Array, coefficients: Coefficients) -> Array:
    """Project Aria's fisheye: radial terms first, the others on their result: (k0 .. k5 p0 p1 s0 .. s3)."""
    p0, p1, s0, s1, s2, s3 = coefficients[6:]
    point, theta = _equidistant(rays)
    point = point * _polynomial(theta**2, coefficients[:6])[..., None]
    x, y = point[..., 0], point[..., 1]
    r2 = x * x + y * y
    bent_x = x + 2 * p1 * x * y + p0 * (r2 + 2 * x * x) + s0 * r2 + s1 * r2 * r2
    bent_y = y + 2 * p0 * x * y + p1 * (r2 + 2 * y * y) + s2 * r2 + s3 * r2 * r2
    return np.stack([bent_x, bent_y], -1)


def equirectangular(rays: Array, coefficients: Coefficients) -> Array:
    """Longitude (0 along z, towards x) and latitude (towards y, down) in radians."""
    x, y, z = np.moveaxis(rays, -1, 0)
    return np.stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))], -1)


FISHEYE_NAMES = ("k1", "k2", "k3", "k4")
MODELS: dict[str, LensModel] = {
    "OPENCV": LensModel(("k1", "k2", "p1", "p2"), opencv, PERSPECTIVE_REACH),
    "FULL_OPENCV": LensModel(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), opencv, PERSPECTIVE_REACH),
    "FOV": LensModel(("omega",), fov, PERSPECTIVE_REACH),
    "DIVISION": LensModel(("k",), division, PERSPECTIVE_REACH),
    "EUCM": LensModel(("alpha", "beta"), eucm, np.pi),
    "OPENCV_FISHEYE": LensModel(FISHEYE_NAMES, fisheye, np.pi),
    "THIN_PRISM_FISHEYE": LensModel(("k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"), thin_prism_fisheye, np.pi),
    "RAD_TAN_THIN_PRISM_FISHEYE": LensModel(
        ("k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1", "s0", "s1", "s2", "s3"), rad_tan_thin_prism_fisheye, np.pi
    ),
    "EQUIRECTANGULAR": LensModel((), equirectangular, np.pi),
}
PINHOLE = "OPENCV"
"""The model of a camera without coefficients."""
STRAIGHT = frozenset({"OPENCV", "FULL_OPENCV"})
"""Models that are a pinhole where every coefficient is 0."""


def is_pinhole(model: str, coefficients: Coefficients) -> bool:
    """Whether a lens keeps straight lines straight: a plane's model without a coefficient."""
    return model in STRAIGHT and not any(coefficients)


def project(model: str, coefficients: Coefficients, rays: Array) -> Array:
    """Image points [..., 2] of rays [..., 3] of any length; NaN where the model has none."""
    return MODELS[model].project(np.asarray(rays, np.float64), coefficients)


def _plane(rays: Array) -> Array:
    """Where a pinhole sees rays; NaN behind it."""
    z = rays[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(z > TINY, rays[..., :2] / z, np.nan)


def _equidistant(rays: Array) -> tuple[Array, Array]:
    """Points [..., 2] at the radius θ, the angle off the axis, and θ."""
    across = np.hypot(rays[..., 0], rays[..., 1])
    theta = np.arctan2(across, rays[..., 2])
    scale = np.where(across > TINY, theta / np.maximum(across, TINY), 1 / np.where(rays[..., 2] != 0, rays[..., 2], 1))
    return rays[..., :2] * scale[..., None], theta


def _polynomial(square: Array, coefficients: Coefficients) -> Array:
    """1 + c0 s + c1 s² + ..."""
    total = np.zeros_like(square)
    for c in reversed(tuple(coefficients)):
        total = (total + c) * square
    return 1 + total
