"""Vertices moved along their normals until the surface faces where the views say: depth ripples, normals do not.

Nehab et al. 2005, "Efficiently combining positions and normals for precise 3D geometry": the fused depths are right over
long distances, the rendered normals (which polarisation measures) over short ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.mesh import Mesh
from pipeline.geometry.normals import cross_products
from pipeline.geometry.topology import edges_of

SHORTEST = 0.1  # of the median edge: below it an edge's direction is the extraction's rounding
HALVINGS = 6  # of the offsets at a triangle that would turn over, before they are dropped


def following_normals(mesh: Mesh, reach: float) -> Mesh:
    """The mesh with its vertices moved along their `normal` attribute: see `offsets_by_normals`.

    Where that would turn a triangle over, its vertices move less far, at last not at all.
    """
    offsets = offsets_by_normals(mesh, reach)
    before = cross_products(mesh.vertices, mesh.faces)
    for attempt in range(2 * HALVINGS):
        moved = mesh.vertices + offsets[:, None] * mesh.attributes["normal"]
        turned = (before * cross_products(moved, mesh.faces)).sum(1) <= 0
        if not turned.any():
            break
        offsets[mesh.faces[turned].ravel()] *= 0.5 if attempt < HALVINGS else 0.0
    return Mesh(moved, mesh.faces, mesh.attributes)


def offsets_by_normals(mesh: Mesh, reach: float) -> NDArray[np.float64]:
    """Displacement [V] of each vertex along its `normal` attribute, in world units.

    Minimises, in median edges, sum over vertices of (d_i / reach)^2 + sum over edges of ((n_i + n_j)/2 . (p_j - p_i) /
    |p_j - p_i|)^2 with p = vertex + d n: features below `reach` median edges follow the normals, larger ones the positions.
    """
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import cg

    n = mesh.attributes["normal"].astype(np.float64)
    f = mesh.faces
    i, j = edges_of(f)
    step = mesh.vertices[j] - mesh.vertices[i]
    length = np.linalg.norm(step, axis=1)
    typical = float(np.median(length))
    mean = n[i] + n[j]
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-6)  # opposite normals: an edge that says nothing
    weight = typical / np.maximum(length, SHORTEST * typical)
    rows = np.arange(len(i))
    a = weight * (mean * n[j]).sum(1)
    b = -weight * (mean * n[i]).sum(1)
    shape = (len(i), len(n))
    slopes = coo_matrix((np.concatenate([a, b]), (np.tile(rows, 2), np.concatenate([j, i]))), shape).tocsr()
    right = -slopes.T @ (weight * (mean * step).sum(1) / typical)
    normal_equations = slopes.T @ slopes + diags(np.full(len(n), reach**-2.0))
    jacobi = diags(1 / normal_equations.diagonal())
    solution, _ = cg(normal_equations, right, rtol=1e-3, maxiter=500, M=jacobi)
    return solution * typical
