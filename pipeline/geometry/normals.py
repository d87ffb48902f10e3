"""Normals of triangle meshes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

UPWARD = (0.0, 0.0, 1.0)


def vertex_normals(
    vertices: NDArray, triangles: NDArray, without: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Compute vertex normals as area-weighted means of the faces'.

    Args:
        vertices: positions. [V, 3]
        triangles: vertex numbers, counter-clockwise from outside. [F, 3]
        without: normal of vertices with no face, or only faces of no area.

    Returns:
        Unit normals. [V, 3]
    """
    area = np.ascontiguousarray(cross_products(vertices, triangles).T)
    corners = np.ascontiguousarray(triangles.T, np.int64)
    total = np.zeros(vertices.shape)
    for k, axis in np.ndindex(3, 3):
        total[:, axis] += np.bincount(corners[k], area[axis], len(vertices))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.tile(without, (len(vertices), 1)), where=length > 0)


def cross_products(vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """Compute the vectors across triangles.

    Args:
        vertices: positions. [V, 3]
        triangles: vertex numbers, counter-clockwise from outside. [F, 3]

    Returns:
        Outward vectors, each twice its triangle's area long. [F, 3]
    """
    at = np.asarray(vertices, np.float64)
    a, b, c = (at[triangles[:, k].astype(np.int64, copy=False)] for k in range(3))
    b -= a
    c -= a
    out = np.empty_like(a)  # by hand: numpy's cross product takes four times as long
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[:, k] = b[:, i] * c[:, j] - b[:, j] * c[:, i]
    return out
