"""Solid angle of each light: its spherical Voronoi cell, cut off at a cap where the rig has a hole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

QUADRATURE_POINTS = 200_000  # 0.06 msr each: 0.5 % of an LSX3 cell's area
CAP_OVER_MEDIAN = 1.25  # times the typical cell's reach; LSX3's regular cells reach 1.07, those at its hole 4.0


def solid_angles(directions: NDArray[np.float64], cap: bool = True) -> NDArray[np.float64]:
    """Solid angle in sr of each light [N] for unit `directions` [N, 3].

    Exact spherical Voronoi areas; with `cap`, cells that reach beyond `CAP_OVER_MEDIAN` times the typical cell's reach
    (next to a hole of the rig, or the rim of a dome) count only up to there. Lights in one direction share their cell.
    """
    unique, inverse, count = np.unique(np.round(directions, 9), axis=0, return_inverse=True, return_counts=True)
    areas, reach = _voronoi(unique)
    if cap and len(unique) > 3:
        radius = CAP_OVER_MEDIAN * float(np.median(reach))
        far = reach > radius
        if far.any():
            areas = np.where(far, np.minimum(_counted(unique, radius), areas), areas)
    return (areas / count)[inverse.ravel()]


def nearest_light(directions: NDArray[np.float64], lights: NDArray[np.float64]) -> NDArray[np.intp]:
    """Index of the light [M] whose cell each unit direction [M, 3] lies in."""
    from scipy.spatial import cKDTree

    return cKDTree(lights).query(directions)[1]


def _voronoi(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Area in sr and reach (angle to the farthest corner, rad) of each cell; by counting where the cells are degenerate."""
    from scipy.spatial import SphericalVoronoi

    try:
        cells = SphericalVoronoi(points, threshold=1e-9)
        areas = cells.calculate_areas()
        reach = np.array([np.arccos(np.clip((cells.vertices[r] @ p).min(), -1, 1)) for r, p in zip(cells.regions, points)])
        if np.isfinite(areas).all() and abs(areas.sum() / (4 * np.pi) - 1) < 1e-6:
            return areas, reach
    except ValueError:  # fewer than four lights, or all in one plane
        pass
    areas = _counted(points, np.pi)
    return areas, np.sqrt(areas / np.pi)


def _counted(points: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Cell areas by counting Fibonacci points nearest to each light and within `radius` (rad)."""
    grid = fibonacci_sphere(QUADRATURE_POINTS)
    owner = nearest_light(grid, points)
    near = np.einsum("ij,ij->i", grid, points[owner]) >= np.cos(radius)
    counts = np.bincount(owner[near], minlength=len(points)).astype(np.float64)
    return counts * (4 * np.pi / QUADRATURE_POINTS)


def fibonacci_sphere(count: int) -> NDArray[np.float64]:
    """`count` near-uniform unit directions [count, 3]."""
    k = np.arange(count) + 0.5
    y, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(turn), y, r * np.sin(turn)], -1)
