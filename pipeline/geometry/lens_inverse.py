"""How far a lens model holds before it folds, and the ray of an image point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.lens_models import MODELS, PERSPECTIVE_REACH, Array, project

AZIMUTHS, STEPS = 72, 2048
ROUNDS, STEP = 12, 1e-6
SOLVED = 1e-11
"""Of a normalised image point: what Newton's rounds leave where there is a ray."""


@dataclass(frozen=True)
class Fold:
    """Where a model's image radius stops growing: angles off the axis and radii [AZIMUTHS], and the radii on the way
    there [STEPS] at the angles [STEPS], their least over the azimuths (NaN past the first fold)."""

    angles: Array
    radii: Array
    way: Array
    profile: Array

    def angle_at(self, azimuth: Array) -> Array:
        """The angle off the axis (rad) at which the model folds in the direction of the azimuth."""
        return _around(self.angles, azimuth)

    def radius_at(self, azimuth: Array) -> Array:
        """The image radius that it has there."""
        return _around(self.radii, azimuth)


def _around(values: Array, azimuth: Array) -> Array:
    at = np.mod(azimuth, 2 * np.pi) / (2 * np.pi) * len(values)
    return np.interp(at, np.arange(len(values) + 1), np.append(values, values[0]))


@lru_cache(maxsize=16)
def fold(model: str, coefficients: tuple[float, ...]) -> Fold:
    """Walk outwards until the image radius shrinks: past that two rays meet in one point, and the model means nothing."""
    way = np.asarray(np.linspace(0, MODELS[model].reach, STEPS), np.float64)
    azimuth = np.asarray(np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS), np.float64)
    points = project(model, coefficients, ray_of(_polar(way[None, :], azimuth[:, None])))
    radius = np.linalg.norm(points - points[:, :1], axis=-1)
    if model == "EQUIRECTANGULAR":  # every ray has its point, and outwards is no direction
        return Fold(np.full(AZIMUTHS, np.pi), np.full(AZIMUTHS, np.inf), way, way)
    with np.errstate(invalid="ignore"):
        grows = np.diff(radius, axis=1) > 0  # False past the model's own end, where points are NaN
    last = np.where(grows.all(1), STEPS - 1, np.argmin(grows, axis=1))
    each = np.arange(AZIMUTHS)
    return Fold(way[last], radius[each, last], way, np.where(way <= way[last.min()], radius.min(0), np.nan))


def _polar(angle: Array, azimuth: Array) -> Array:
    return np.stack(np.broadcast_arrays(angle * np.cos(azimuth), angle * np.sin(azimuth)), -1)


def ray_of(flat: Array) -> Array:
    """Unit rays [..., 3] of points [..., 2] at the radius of their angle off the axis."""
    angle = np.linalg.norm(flat, axis=-1)
    across = flat * np.sinc(angle / np.pi)[..., None]
    return np.concatenate([across, np.cos(angle)[..., None]], -1)


def plane_ray(flat: Array) -> Array:
    """Rays [..., 3] through points [..., 2] of the plane one unit ahead."""
    return np.concatenate([flat, np.ones_like(flat[..., :1])], -1)


def inside_fold(model: str, coefficients: tuple[float, ...], rays: Array) -> NDArray[np.bool_]:
    """Whether rays [..., 3] lie where the model does not fold."""
    angle = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    return np.asarray(angle <= fold(model, coefficients).angle_at(np.arctan2(rays[..., 1], rays[..., 0])) + 1e-9)


def unproject(model: str, coefficients: tuple[float, ...], points: Array) -> Array:
    """Unit rays [..., 3] of image points [..., 2]; NaN where the model puts no ray.

    Newton's method on the ray's place in the plane of a pinhole, or on the angles across for lenses that see past it; from
    the model's own radius by angle.
    """
    points = np.asarray(points, np.float64)
    if model == "EQUIRECTANGULAR":
        longitude, latitude = points[..., 0], points[..., 1]
        ring = np.cos(latitude)
        return np.stack([np.sin(longitude) * ring, np.sin(latitude), np.cos(longitude) * ring], -1)
    flat_points = points.reshape(-1, 2)
    in_plane = MODELS[model].reach == PERSPECTIVE_REACH
    lift = plane_ray if in_plane else ray_of
    flat = _start(model, coefficients, flat_points, in_plane)
    solved = np.zeros(len(flat), bool)
    left = np.arange(len(flat))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for _ in range(ROUNDS):
            off = project(model, coefficients, lift(flat[left])) - flat_points[left]
            done = np.abs(off).max(-1) < SOLVED * (1 + np.abs(flat_points[left]).max(-1))
            solved[left[done]] = True
            left, off = left[~done], off[~done]
            if not len(left):
                break
            flat[left] -= _solved(_jacobian(model, coefficients, lift, flat[left]), off)
    rays = lift(flat)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    within = in_plane | (np.linalg.norm(flat, axis=-1) <= MODELS[model].reach)
    sound = solved & within & inside_fold(model, coefficients, rays)
    return np.where(sound[:, None], rays, np.nan).reshape(*points.shape[:-1], 3)


def _start(model: str, coefficients: tuple[float, ...], points: Array, in_plane: bool) -> Array:
    """Places in the plane (or angles across) [N, 2] that image points [N, 2] have by the model's radii alone."""
    known = fold(model, coefficients)
    offset = points - project(model, coefficients, np.array([0.0, 0.0, 1.0]))
    there = np.isfinite(known.profile)
    angle = np.interp(np.linalg.norm(offset, axis=-1), known.profile[there], known.way[there])
    return _polar(np.tan(angle) if in_plane else angle, np.arctan2(offset[:, 1], offset[:, 0]))


def _jacobian(model: str, coefficients: tuple[float, ...], lift: Callable[[Array], Array], flat: Array) -> Array:
    """Derivative [..., 2 (point), 2 (flat)] of the image point."""
    sides = []
    for axis in np.eye(2) * STEP:
        ahead, behind = (project(model, coefficients, lift(flat + s * axis)) for s in (1, -1))
        sides.append((ahead - behind) / (2 * STEP))
    return np.stack(sides, -1)


def _solved(matrix: Array, right: Array) -> Array:
    """The solutions [..., 2] of 2x2 systems; huge or NaN where one is singular."""
    (a, b), (c, d) = (np.moveaxis(matrix[..., k, :], -1, 0) for k in range(2))
    u, v = np.moveaxis(right, -1, 0)
    return np.stack([d * u - b * v, a * v - c * u], -1) / (a * d - b * c)[..., None]


def pixels_per_radian(model: str, coefficients: tuple[float, ...], focal: tuple[float, float], ray: Array) -> float:
    """The picture's local scale about a ray [3]: the geometric mean over its directions."""
    helper = np.eye(3)[int(np.argmin(np.abs(ray)))]
    first = np.cross(ray, helper)
    first /= np.linalg.norm(first)
    second = np.cross(ray, first)
    sides = [
        (project(model, coefficients, ray + STEP * a) - project(model, coefficients, ray - STEP * a)) * focal / (2 * STEP)
        for a in (first, second)
    ]
    return float(np.sqrt(abs(np.linalg.det(np.stack(sides)))))
