"""A lamp as points see it: directions and solid angles of its parts, or all lamps together as an environment map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.occluder import tangent_frames
from pipeline.geometry.world import Y_UP_FROM

from .lights_file import Light, RectangleLight, SphereLight

MAP_ROWS = 256  # of lamps as a map
MAP_SIDE = 128  # cells along a lamp's side there: several to a texel


@dataclass(frozen=True)
class Samples:
    """Light that arrives at P points from K places of a lamp: direction [P, K, 3] (unit, to the lamp), distance [P, K]
    (infinite for a distant one), solid angle [P, K] that each place stands for, radiance [3]."""

    direction: NDArray[np.float64]
    distance: NDArray[np.float64]
    solid_angle: NDArray[np.float64]
    radiance: NDArray[np.float64]


def samples(light: Light, points: NDArray, side: int) -> Samples:
    """A lamp seen from points [P, 3], cut into side x side cells: of equal solid angle, or of a rectangle, of equal area."""
    u, v = (x.ravel() for x in np.meshgrid(*[(np.arange(side) + 0.5) / side] * 2))
    if isinstance(light, RectangleLight):
        return _of_rectangle(light, points, u, v)
    if isinstance(light, SphereLight):
        towards = np.asarray(light.centre, float) - points
        distance = np.linalg.norm(towards, axis=1)
        half = np.arcsin(np.clip(light.radius / np.maximum(distance, 1e-30), 0, 1))
        away = np.maximum(distance - light.radius, 0)
        cone = _cone(towards / np.maximum(distance, 1e-30)[:, None], half, u, v)
        reach = np.broadcast_to(away[:, None], cone[1].shape)
        return Samples(cone[0], reach, cone[1], np.asarray(light.radiance, float))
    axis = np.asarray(light.towards, float) / np.linalg.norm(light.towards)
    half = np.full(1, np.radians(max(light.angle_deg, 1e-3)) / 2)
    direction, angle = (np.broadcast_to(x, (len(points), *x.shape[1:])) for x in _cone(axis[None], half, u, v))
    across = np.pi * np.sin(half[0]) ** 2  # projected solid angle of the disc
    return Samples(direction, np.full(angle.shape, np.inf), angle, np.asarray(light.irradiance, float) / across)


def _cone(axis: NDArray, half: NDArray, u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    """Directions [P, K, 3] in cones of half angles `half` [P] about unit axes [P, 3], and their solid angles [P, K].

    The unit square goes to the disc in rings that keep areas and shapes (Shirley and Chiu 1997).
    """
    a, b = 2 * u - 1, 2 * v - 1
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    over = np.where(radius == 0, 1, radius)
    turn = np.where(wide, np.pi / 4 * b / over, np.pi / 2 - np.pi / 4 * a / over)
    rise = (1 - np.cos(half))[:, None] * (radius * radius)[None]  # 1 - cosine
    sine = np.sqrt(np.maximum(rise * (2 - rise), 0)) * np.sign(radius)
    x, y, z = np.moveaxis(tangent_frames(axis), 1, 0)
    local = (sine * np.cos(turn))[..., None] * x[:, None] + (sine * np.sin(turn))[..., None] * y[:, None]
    angle = np.broadcast_to((2 * np.pi * (1 - np.cos(half)) / len(u))[:, None], sine.shape)
    return local + (1 - rise)[..., None] * z[:, None], angle


def _of_rectangle(light: RectangleLight, points: NDArray, u: NDArray, v: NDArray) -> Samples:
    centre, edge_u, edge_v = (np.asarray(x, float) for x in (light.centre, light.edge_u, light.edge_v))
    places = centre + (u - 0.5)[:, None] * edge_u + (v - 0.5)[:, None] * edge_v
    area = np.cross(edge_u, edge_v)
    size = float(np.linalg.norm(area))
    to = places[None] - points[:, None]
    distance = np.maximum(np.linalg.norm(to, axis=-1), 1e-6 * np.sqrt(size))
    direction = to / distance[..., None]
    facing = -(direction @ (area / size))
    facing = np.abs(facing) if light.two_sided else np.maximum(facing, 0)
    angle = np.minimum(size / len(u) * facing / distance**2, 2 * np.pi)
    return Samples(direction, distance, angle, np.asarray(light.radiance, float))


def as_map(lights: Sequence[Light], centre: NDArray, up: str) -> NDArray[np.float32]:
    """The lights as a point [3] sees them: latitude-longitude radiance [MAP_ROWS, 2 MAP_ROWS, 3], y up."""
    image = np.zeros((MAP_ROWS, 2 * MAP_ROWS, 3))
    rows = np.arange(MAP_ROWS + 1) * np.pi / MAP_ROWS
    texel = (np.cos(rows[:-1]) - np.cos(rows[1:])) * np.pi / MAP_ROWS
    for light in lights:
        seen = samples(light, np.asarray(centre, float)[None], MAP_SIDE)
        x, y, z = (seen.direction[0] @ Y_UP_FROM[up].T).T
        row = np.minimum((np.arccos(np.clip(y, -1, 1)) / np.pi * MAP_ROWS).astype(int), MAP_ROWS - 1)
        column = (np.arctan2(x, -z) / (2 * np.pi) % 1 * 2 * MAP_ROWS).astype(int) % (2 * MAP_ROWS)
        np.add.at(image, (row, column), seen.solid_angle[0][:, None] / texel[row][:, None] * seen.radiance)
    return image.astype(np.float32)
