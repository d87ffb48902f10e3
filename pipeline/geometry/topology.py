"""How a triangle mesh hangs together: edges, pieces, handles, triangles that look inward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.normals import cross_products, vertex_normals

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Topology:
    """How a mesh hangs together.

    Fields:
        components: connected pieces.
        genus: handles in all of them; None where the surface is not closed.
        open_edges: edges of one triangle.
        crowded_edges: edges of three or more.
        inside_out: triangles against the normals of all their corners.
    """

    components: int
    genus: int | None
    open_edges: int
    crowded_edges: int
    inside_out: int


def edges_of(faces: NDArray) -> tuple[Index, Index]:
    """List each edge of a triangle mesh once.

    Args:
        faces: vertex numbers. [F, 3]

    Returns:
        Its two vertices, the smaller number first. [E] each
    """
    first, second, _ = _counted_edges(faces)
    return first, second


def pieces(faces: NDArray, vertices: int) -> tuple[int, NDArray[np.int32]]:
    """Label the connected pieces of a triangle mesh.

    Args:
        faces: vertex numbers. [F, 3]
        vertices: their count V.

    Returns:
        How many pieces, and each vertex's [V]; a vertex that no triangle uses is its own.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges), np.int8), edges.T), (vertices, vertices))
    count, label = connected_components(graph, directed=False)
    return int(count), label


def topology(vertices: NDArray, faces: NDArray) -> Topology:
    """Describe how a triangle mesh hangs together; vertices that no triangle uses do not count.

    Args:
        vertices: positions. [V, 3]
        faces: vertex numbers. [F, 3]

    Returns:
        Pieces, genus (None where the mesh is open or an edge has more than two faces), such edges, triangles inside out.
    """
    needed = np.zeros(len(vertices), bool)
    needed[faces] = True
    used, faces = np.flatnonzero(needed), (np.cumsum(needed) - 1)[faces]
    first, _, count = _counted_edges(faces)
    found, _ = pieces(faces, len(used))
    open_edges, crowded = int((count == 1).sum()), int((count > 2).sum())
    euler = len(used) - len(first) + len(faces)
    genus = None if open_edges or crowded else (2 * found - euler) // 2
    return Topology(found, genus, open_edges, crowded, int(inside_out(vertices[used], faces).sum()))


def inside_out(vertices: NDArray, faces: NDArray) -> NDArray[np.bool_]:
    """Find triangles that face against the normals of all three of their corners: specks that are seen from behind.

    Args:
        vertices: positions. [V, 3]
        faces: vertex numbers. [F, 3]

    Returns:
        True for those. [F]
    """
    across = cross_products(vertices, faces)
    corner = vertex_normals(vertices, faces)[faces]
    return np.asarray((np.einsum("fc,fkc->fk", across, corner) < 0).all(1))


def _counted_edges(faces: NDArray) -> tuple[Index, Index, Index]:
    f = np.asarray(faces, np.int64)
    ends = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
    base = int(f.max()) + 1 if f.size else 1
    keys, count = np.unique(ends[:, 0] * base + ends[:, 1], return_counts=True)
    return keys // base, keys % base, count
