"""The visual hull's mesh as the splats have carried it along: what rays are cast at while training."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pipeline.geometry.normals import vertex_normals
from pipeline.geometry.rays import RayHits, RayMesh

from ..initialise.hull import HullMesh
from .gaussians import SplatModel

NEAREST = 4  # splats that carry a hull vertex
LEVEL = 0.25  # of the distance to the last of them, within which inverse-square weights are level: no vertex hangs on one splat


@dataclass(frozen=True)
class CarriedHull:
    """A triangle mesh to cast rays at, and for each vertex the nearest splat (whose material it shows)."""

    rays: RayMesh
    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    splat_of_vertex: np.ndarray

    def cast(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of rays [M, 6] (origins, then directions) those that hit an outer side [K], and the splats nearest to where [K].

        A first hit from behind means that the ray began just under the surface: it counts as free.
        """
        rows = np.flatnonzero(self.rays.blocked_packed(rays))  # few, so that where they end is asked of these alone
        outer, found = self.met(rays[rows])
        return rows[outer], self.splat_of_vertex[self.triangles[found.triangle, found.corner]]

    def met(self, rays: np.ndarray) -> tuple[np.ndarray, RayHits]:
        """Which of rays [M, 6] (origins, then directions) hit an outer side [K], and where these do."""
        found = self.rays.cast_packed(rays)
        outer = np.flatnonzero(found.hit & (np.einsum("mk,mk->m", found.normal, rays[:, 3:]) < 0))
        return outer, found.of(outer)


def carried_hull(hull: HullMesh, model: SplatModel) -> CarriedHull:
    """The hull with every vertex moved as its nearest splats have moved since the start."""
    anchors = model["anchor"].detach().cpu().double().numpy()
    moved = model["position"].detach().cpu().double().numpy() - anchors
    distance, index = cKDTree(anchors).query(hull.vertices, k=min(NEAREST, len(anchors)))
    weight = 1 / (distance**2 + (LEVEL * np.median(distance[:, -1])) ** 2)
    weight /= weight.sum(-1, keepdims=True)
    vertices = hull.vertices + (weight[..., None] * moved[index]).sum(1)
    return CarriedHull(
        RayMesh(vertices, hull.triangles), vertices, hull.triangles, vertex_normals(vertices, hull.triangles), index[:, 0]
    )
