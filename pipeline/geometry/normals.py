"""Normals of triangle meshes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

UPWARD = (0.0, 0.0, 1.0)


def vertex_normals(
    vertices: NDArray, triangles: NDArray, without: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Unit normals [V, 3]: area-weighted means of the faces'; `without` at vertices whose faces have no area (or no faces)."""
    corners = vertices.astype(np.float64)[triangles.astype(np.int64)]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros(vertices.shape)
    for k in range(3):
        np.add.at(total, triangles[:, k].astype(np.int64), area)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.tile(without, (len(vertices), 1)), where=length > 0)
