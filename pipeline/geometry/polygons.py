"""Polygons cut up into triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def triangulated(lengths: NDArray[np.int64], corners: NDArray[np.int64], vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cut polygons into triangles, each as a fan.

    The fan starts at the first corner from which no triangle of it turns over: any corner of a convex polygon, at least one of
    a concave quadrilateral. Faces of fewer than three corners hold no triangle.

    Args:
        lengths: corners of each polygon. [F]
        corners: their vertex numbers, one polygon after another. [sum of lengths]
        vertices: positions. [V, 3]

    Returns:
        Vertex numbers of the triangles, in the polygons' order. [T, 3]
    """
    begins = np.cumsum(lengths) - lengths
    parts, places = [], []
    for n in np.unique(lengths[lengths > 2]):
        which = np.flatnonzero(lengths == n)
        polygon = corners[begins[which, None] + np.arange(n)]
        if n > 3:
            point = vertices[polygon]
            normal = np.cross(point - point[:, :1], np.roll(point, -1, 1) - point[:, :1]).sum(1)
            best, least = np.zeros(len(which), np.int64), np.full(len(which), -np.inf)
            for start in range(n):
                turned = np.roll(point, -start, 1) - point[:, start, None]
                facing = (np.cross(turned[:, 1:-1], turned[:, 2:]) * normal[:, None]).sum(-1).min(1)
                better = (least <= 0) & (facing > least)
                best, least = np.where(better, start, best), np.where(better, facing, least)
            polygon = np.take_along_axis(polygon, (best[:, None] + np.arange(n)) % n, 1)
        fan = np.stack([np.repeat(polygon[:, :1], n - 2, 1), polygon[:, 1:-1], polygon[:, 2:]], -1)
        parts.append(fan.reshape(-1, 3))
        places.append(np.repeat(which, n - 2))
    if not parts:
        return np.zeros((0, 3), np.int64)
    return np.concatenate(parts)[np.argsort(np.concatenate(places), kind="stable")]
