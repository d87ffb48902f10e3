"""Solid angle of each light: its spherical Voronoi cell, cut off at a cap where the rig has a hole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CAP_OVER_MEDIAN = 1.25  # times the typical cell's reach; LSX3's regular cells reach 1.07, those at its hole 4.0
AZIMUTHS = 360  # directions in which a cell's border is measured: areas to 1e-4 of themselves
BLOCK = 256  # lights whose cells are measured at a time
NEIGHBOURS = 16  # lights that are tried first as a cell's neighbours; most cells have six


def solid_angles(directions: NDArray[np.float64], cap: bool = True) -> NDArray[np.float64]:
    """Compute each light's solid angle, the area of its spherical Voronoi cell.

    Args:
        directions: unit. Lights in one direction share their cell. [N, 3]
        cap: count cells that reach beyond `CAP_OVER_MEDIAN` times the typical cell's reach (next to a hole of the rig, or the
            rim of a dome) only up to there.

    Returns:
        sr. [N]
    """
    unique, inverse, count = np.unique(np.round(directions, 9), axis=0, return_inverse=True, return_counts=True)
    border = np.concatenate([_borders(unique, k, k + BLOCK) for k in range(0, len(unique), BLOCK)])
    share = 4 * np.pi / (2 * np.pi * np.mean(1 - border, 1)).sum()  # the cells fill the sphere
    if cap and len(unique) > 3:
        border = np.maximum(border, np.cos(CAP_OVER_MEDIAN * np.median(np.arccos(border.min(1)))))
    areas = share * 2 * np.pi * np.mean(1 - border, 1)
    return (areas / count)[inverse.ravel()]


def _borders(points: NDArray[np.float64], first: int, last: int) -> NDArray[np.float64]:
    """Cosine of the angle from points[first:last] to the border of their cells, in `AZIMUTHS` directions about each.

    Along the great circle at azimuth e the cell ends at the first bisector: cot r = max over the other points p_j of
    e·t_j / (1 - p_j·p), t_j their part across the cell's p. A negative one lies beyond 90 degrees.
    """
    if len(points) < 2:
        return np.full((len(points), AZIMUTHS), -1.0)
    centre = points[first:last]
    across = np.cross(centre, np.eye(3)[np.argmin(np.abs(centre), -1)])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    along = np.cross(centre, across)
    gap, x, y = np.zeros((3, len(centre), len(points)))
    for axis in range(3):
        gap += 0.5 * (points[:, axis] - centre[:, axis, None]) ** 2  # 1 - cosine, without its cancellation
        x += points[:, axis] * across[:, axis, None]
        y += points[:, axis] * along[:, axis, None]
    row = np.arange(len(centre))
    gap[row, first + row] = np.inf
    x, y = x / gap, y / gap
    strength = np.hypot(x, y)
    angle = (np.arange(AZIMUTHS) + 0.5) * (2 * np.pi / AZIMUTHS)
    cosine, sine = np.cos(angle), np.sin(angle)
    count = min(NEIGHBOURS, len(points) - 1)
    cotangent = np.full((len(centre), AZIMUTHS), -np.inf)
    for nearest in np.argpartition(-strength, count - 1, axis=1)[:, :count].T:
        pull = x[row, nearest, None] * cosine + y[row, nearest, None] * sine
        np.maximum(cotangent, pull, out=cotangent)
    beyond = np.count_nonzero(strength > cotangent.min(1)[:, None], 1) > count
    for k in map(int, np.flatnonzero(beyond)):  # the border may lie beyond the nearest
        others = np.delete(np.arange(len(points)), first + k)
        cotangent[k] = np.max(x[k, others, None] * cosine + y[k, others, None] * sine, 0)
    return cotangent / np.sqrt(1 + cotangent**2)


def nearest_light(directions: NDArray[np.float64], lights: NDArray[np.float64]) -> NDArray[np.intp]:
    """Index of the light [M] whose cell each unit direction [M, 3] lies in."""
    from scipy.spatial import cKDTree

    return cKDTree(lights).query(directions)[1]


def fibonacci_sphere(count: int) -> NDArray[np.float64]:
    """Spread directions nearly evenly over the sphere.

    Args:
        count: how many.

    Returns:
        Unit directions. [count, 3]
    """
    k = np.arange(count) + 0.5
    y, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(turn), y, r * np.sin(turn)], -1)
