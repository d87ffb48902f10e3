"""A triangle mesh with attributes on its vertices: pieces of it, and its parts in a fixed order."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.normals import UPWARD, cross_products, vertex_normals
from pipeline.geometry.topology import pieces


@dataclass
class Mesh:
    """Triangles over vertices that carry attributes.

    Fields:
        vertices: positions. [V, 3]
        faces: vertex numbers, counter-clockwise from outside. [F, 3]
        attributes: of the vertices, by name. [V, C]
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    attributes: dict[str, NDArray[np.float32]] = field(default_factory=dict)

    @classmethod
    def from_open3d(cls, mesh: Any) -> Mesh:
        """Vertices and triangles of an Open3D tensor mesh."""
        if "positions" not in mesh.vertex or "indices" not in mesh.triangle:
            return cls(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
        return cls(mesh.vertex.positions.numpy().astype(np.float64), mesh.triangle.indices.numpy().astype(np.int64))

    def area(self) -> NDArray[np.float64]:
        """Area of each triangle [F]."""
        return np.linalg.norm(cross_products(self.vertices, self.faces), axis=1) / 2

    def normals(self) -> NDArray[np.float64]:
        """Area-weighted unit vertex normals [V, 3]; +z where a vertex has no area to tell."""
        return vertex_normals(self.vertices, self.faces, UPWARD)


def keep_faces(mesh: Mesh, keep: NDArray[np.bool_]) -> Mesh:
    """Keep the chosen triangles and the vertices that they use.

    Args:
        mesh: to choose from.
        keep: which triangles stay. [F]

    Returns:
        A mesh of those alone, with their vertices' attributes.
    """
    faces = mesh.faces[keep]
    needed = np.zeros(len(mesh.vertices), bool)
    needed[faces] = True
    used = np.flatnonzero(needed)
    place = np.cumsum(needed) - 1
    return Mesh(mesh.vertices[used], place[faces], {k: v[used] for k, v in mesh.attributes.items()})


def largest_pieces(mesh: Mesh, share: float) -> Mesh:
    """Keep the connected pieces of at least a share of the largest one's area.

    Args:
        mesh: to choose from.
        share: of the largest piece's area.

    Returns:
        Those pieces; the mesh itself where it has no triangles.
    """
    if not len(mesh.faces):
        return mesh
    _, label = pieces(mesh.faces, len(mesh.vertices))
    area = np.bincount(label[mesh.faces[:, 0]], mesh.area(), label.max() + 1)
    return keep_faces(mesh, area[label[mesh.faces[:, 0]]] >= share * area.max())


def without_slivers(mesh: Mesh) -> Mesh:
    """Leave out triangles of zero area or with a vertex twice.

    Args:
        mesh: to choose from.

    Returns:
        The rest of it.
    """
    f = mesh.faces
    distinct = (f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])
    return keep_faces(mesh, distinct & (mesh.area() > 0))


def in_fixed_order(mesh: Mesh) -> Mesh:
    """Sort vertices by coordinates and triangles by their vertices: the extraction's own order varies from run to run.

    Args:
        mesh: in any order.

    Returns:
        The same mesh.
    """
    order = np.lexsort(mesh.vertices.T)
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    faces = place[mesh.faces]
    first = faces.argmin(1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, 1)
    faces = faces[np.lexsort(faces.T[::-1])]
    return Mesh(mesh.vertices[order], faces, {k: v[order] for k, v in mesh.attributes.items()})
