"""As few triangles as keep the surface where it is: quadric decimation as far as a tolerance allows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.mesh import Mesh, without_slivers
from pipeline.geometry.rays import RayMesh
from pipeline.geometry.topology import topology

FACTOR = 2.0  # fewer triangles from step to step; the last two steps' interval is halved once
MOST_STEPS = 20
FEWEST = 64  # triangles: below it nothing is saved
STRAY = 1e-3  # of the vertices may lie farther off: single spikes of the extraction, which no outline shows
SAMPLED = 100_000  # vertices whose distance is measured, of more: a hundred of them lie beyond STRAY


def decimated(mesh: Mesh, tolerance: float) -> Mesh:
    """The mesh with as few triangles as keep all but STRAY of its vertices within `tolerance` (world units) of the surface.

    A surface that is displaced by no more moves no outline by more, in no view. Attributes are dropped: positions are new.
    Garland and Heckbert 1997 (Open3D's), in halvings; a step that would tear a closed mesh or turn triangles over is not taken.
    """
    kept, fewer = mesh, len(mesh.faces)
    factor = FACTOR
    whole = topology(mesh.vertices, mesh.faces)
    for _ in range(MOST_STEPS):
        target = int(fewer / factor)
        if target < FEWEST:
            break
        candidate = _simplified(kept, target)
        shape = topology(candidate.vertices, candidate.faces)
        sound = shape.crowded_edges <= whole.crowded_edges and shape.open_edges <= whole.open_edges
        if sound and len(candidate.faces) < len(kept.faces) and _distance(candidate, mesh.vertices) <= tolerance:
            kept, fewer = candidate, len(candidate.faces)
            if factor < FACTOR:
                break
        elif factor < FACTOR:
            break
        else:
            factor = FACTOR**0.5
    return kept


def _simplified(mesh: Mesh, faces: int) -> Mesh:
    import open3d as o3d

    vector = o3d.utility
    dense = o3d.geometry.TriangleMesh(vector.Vector3dVector(mesh.vertices), vector.Vector3iVector(mesh.faces.astype(np.int32)))
    sparse = dense.simplify_quadric_decimation(faces)
    return without_slivers(Mesh(np.asarray(sparse.vertices), np.asarray(sparse.triangles).astype(np.int64)))


def _distance(surface: Mesh, points: NDArray) -> float:
    """The distance that all but STRAY of the points [P, 3] have to a surface at most, by a sample of them."""
    points = points[:: max(1, len(points) // SAMPLED)]
    near = RayMesh(surface.vertices, surface.faces).closest(points).position
    return float(np.quantile(np.linalg.norm(near - points, axis=1), 1 - STRAY))
