"""Latitude-longitude maps as light on a rig: texel directions, and the radiance that falls into each light's cell.

Convention: y up, row 0 along +y, (x, y, z) at u = atan2(x, -z) / 2 pi, v = acos(y) / pi. Free of torch, which a light-stage
capture never loads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.world import Y_UP_FROM
from pipeline.rig.solid_angles import fibonacci_sphere, nearest_light

BLOCK = 1 << 16  # texels whose nearest light is looked up at a time


def texels(height: int, width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit directions [H, W, 3] of a map's texel centres, y up, and their solid angles [H, 1] in sr."""
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    phi = (np.arange(width) + 0.5) * (2 * np.pi / width)
    s = np.sin(theta)[:, None]
    d = np.stack(np.broadcast_arrays(s * np.sin(phi), np.cos(theta)[:, None], -s * np.cos(phi)), -1)
    edges = np.cos(np.arange(height + 1) * (np.pi / height))
    return d, (edges[:-1] - edges[1:])[:, None] * (2 * np.pi / width)


def irradiance_per_light(latlong: NDArray, lights: NDArray[np.float64], up: str = "y") -> NDArray[np.float64]:
    """The light that each of `lights` [N, 3] (unit, world) stands for: radiance summed over its cell, RGB [N, 3].

    It is the irradiance on a surface facing that light. Every texel belongs to its nearest light, so nothing of the map is lost
    where the rig has a hole.
    """
    height, width = latlong.shape[:2]
    directions, areas = texels(height, width)
    flat = directions.reshape(-1, 3)
    power = (np.nan_to_num(np.asarray(latlong, np.float64)[..., :3]) * areas[..., None]).reshape(-1, 3)
    local = lights @ Y_UP_FROM[up].T
    out = np.zeros((len(lights), 3))
    for start in range(0, len(flat), BLOCK):
        owner = nearest_light(flat[start : start + BLOCK], local)
        for c in range(3):
            out[:, c] += np.bincount(owner, power[start : start + BLOCK, c], len(lights))
    return out


def as_lights(latlong: NDArray, count: int, up: str = "y") -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """A map as `count` distant lights: directions [count, 3] in the capture's world, irradiance [count, 3], spacing (rad).

    Directions are the radiance-weighted centres of near-uniform cells, so that a sun stays where it is.
    """
    height, width = latlong.shape[:2]
    directions, areas = texels(height, width)
    flat = directions.reshape(-1, 3)
    power = (np.nan_to_num(np.asarray(latlong, np.float64)[..., :3]) * areas[..., None]).reshape(-1, 3)
    cells = fibonacci_sphere(count)
    owner: NDArray[np.intp] = np.concatenate([nearest_light(flat[s : s + BLOCK], cells) for s in range(0, len(flat), BLOCK)])
    light: NDArray[np.float64] = np.stack([np.bincount(owner, power[:, c], count).astype(float) for c in range(3)], -1)
    weight = power.mean(-1)
    centre = np.stack([np.bincount(owner, weight * flat[:, c], count) for c in range(3)], -1)
    size = np.linalg.norm(centre, axis=1, keepdims=True)
    centre = np.where(size > 0, centre / np.where(size > 0, size, 1.0), cells)
    return centre @ Y_UP_FROM[up], light, float(np.sqrt(4 * np.pi / count))
