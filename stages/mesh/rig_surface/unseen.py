"""The surface where no camera sees it: a guess, which has nothing finer than what bounds it."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from pipeline.geometry.mesh import Mesh
from pipeline.geometry.topology import edges_of

ROUNDS = 15  # of means over the neighbours: relief of less than about four edges goes, and outlines stay where they are


def smoothed_where_unseen(mesh: Mesh) -> Mesh:
    """The mesh with the vertices that no camera sees (`coverage` 0) between their neighbours, with their new normals.

    What is guessed comes out of a hull's corners and of distances to the nearest seen point: crumpled, as no object is.
    """
    unseen = np.flatnonzero(mesh.attributes["coverage"] == 0)
    i, j = edges_of(mesh.faces)
    count = len(mesh.vertices)
    joined = sparse.coo_matrix((np.ones(2 * len(i)), (np.concatenate([i, j]), np.concatenate([j, i]))), (count, count)).tocsr()
    means = sparse.diags(1 / np.maximum(np.asarray(joined.sum(1)).ravel(), 1)) @ joined
    means = means.tocsr()[unseen]
    vertices = mesh.vertices.copy()
    for _ in range(ROUNDS):
        vertices[unseen] = 0.5 * (vertices[unseen] + means @ vertices)
    moved = Mesh(vertices, mesh.faces, dict(mesh.attributes))
    normal = moved.attributes["normal"].copy()
    normal[unseen] = moved.normals()[unseen]
    moved.attributes["normal"] = normal
    return moved
