"""A mesh with hollows: every point of its surface taken back by a depth, whatever that does to the topology."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from pipeline.geometry.rays import RayMesh

from ..initialise.hull import HullMesh, smoothed, without_debris

RESOLUTION = 128  # voxels along the longest side


class DepthField:
    """Depth at any point of a surface from samples of it: inverse-square mean of the nearest four."""

    def __init__(self, points: np.ndarray, depths: np.ndarray) -> None:
        self.tree, self.depths = cKDTree(points), depths
        self.spacing = float(np.median(self.tree.query(points, k=2)[0][:, 1]))

    def at(self, points: np.ndarray) -> np.ndarray:
        """Depths [M] at points [M, 3]."""
        distance, index = self.tree.query(points, k=min(4, len(self.depths)))
        weight = 1 / (distance**2 + (0.1 * self.spacing) ** 2)  # a sample's own depth within a tenth of the spacing
        return (self.depths[index] * weight).sum(1) / weight.sum(1)


def hollowed(mesh: HullMesh, field: DepthField, resolution: int = RESOLUTION) -> HullMesh | None:
    """The surface of all points that lie deeper inside `mesh` than the field asks at their nearest surface point.

    `resolution`: voxels along the longest side. None where nothing would be left.
    """
    from skimage.measure import marching_cubes

    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    spacing = float((high - low).max()) / resolution
    low = low - 3 * spacing
    shape = np.ceil((high + 3 * spacing - low) / spacing).astype(int) + 1
    axes = [low[k] + spacing * np.arange(shape[k]) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    surface = RayMesh(mesh.vertices, mesh.triangles)
    solid = surface.inside(grid).reshape(shape)
    # Whole voxels far from the surface; the exact distance where the new surface can run.
    inside = spacing * (ndimage.distance_transform_edt(solid) - ndimage.distance_transform_edt(~solid)).ravel()
    near = (inside > -3 * spacing) & (inside < float(field.depths.max()) + 3 * spacing)
    points = grid[near]
    foot = surface.closest(points).position
    distance = np.linalg.norm(points - foot, axis=-1)
    inside[near] = np.where(solid.ravel()[near], distance, -distance) - field.at(foot)
    volume = without_debris(ndimage.gaussian_filter(inside.reshape(shape), 0.8))
    if not (volume > 0).any():
        return None
    found, triangles, *_ = marching_cubes(volume, 0.0, spacing=(spacing,) * 3)
    return smoothed(found + low, triangles[:, ::-1].astype(np.int64), rounds=6)
