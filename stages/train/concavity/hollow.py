"""A mesh with hollows: every point of its surface taken back by a depth, whatever that does to the topology."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from pipeline.geometry.rays import RayMesh

from ..initialise.hull import HullMesh, smoothed, without_debris

RESOLUTION = 128  # voxels along the longest side, at most
FINER = 3.0  # voxels between two splats: the new surface is sampled by splats as far apart, and its rims lie between them


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


def hollowed(mesh: HullMesh, field: DepthField, splat_spacing: float) -> HullMesh | None:
    """The surface of all points that lie deeper inside `mesh` than the field asks at their nearest surface point.

    `splat_spacing`: between the splats that will lie on it, in units of the mesh. None where nothing would be left.
    """
    from skimage.measure import marching_cubes

    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    spacing = max(float((high - low).max()) / RESOLUTION, splat_spacing / FINER)
    low = low - 3 * spacing
    shape = np.ceil((high + 3 * spacing - low) / spacing).astype(int) + 1
    axes = [low[k] + spacing * np.arange(shape[k]) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    surface = RayMesh(mesh.vertices, mesh.triangles)
    solid = surface.inside(grid)
    below = _in_whole_voxels(solid, field, low, spacing)
    close = _beside_the_new_surface(below, 2 * spacing)
    points = grid[close]
    foot = surface.closest(points).position
    distance = np.linalg.norm(points - foot, axis=-1)
    below[close] = np.where(solid[close], distance, -distance) - field.at(foot)
    volume = without_debris(ndimage.gaussian_filter(below, 0.8))
    if not (volume > 0).any():
        return None
    found, triangles, *_ = marching_cubes(volume, 0.0, spacing=(spacing,) * 3)
    return smoothed(found + low, triangles[:, ::-1].astype(np.int64), rounds=6)


def _in_whole_voxels(solid: np.ndarray, field: DepthField, low: np.ndarray, spacing: float) -> np.ndarray:
    """How far inside the new surface each voxel lies, right to two voxels: distances between voxels, and the field at these.

    The nearest point of a mesh costs as much as a hundred voxels here, and few lie where the new surface runs.
    """
    depth, nearest = ndimage.distance_transform_edt(solid, return_indices=True)
    inside = spacing * (depth - ndimage.distance_transform_edt(~solid))
    rows = np.ravel_multi_index(tuple(nearest[:, solid]), solid.shape)
    outer, back = np.unique(rows, return_inverse=True)  # the voxels just outside, each asked once
    feet = low + spacing * np.stack(np.unravel_index(outer, solid.shape), -1)
    inside[solid] -= field.at(feet)[back]
    return np.asarray(inside)


def _beside_the_new_surface(below: np.ndarray, error: float) -> np.ndarray:
    """Voxels whose sign could be another within an error or is one beside another, and what smoothing mixes with them."""
    inside = below > 0
    edge = ndimage.binary_dilation(inside) & ndimage.binary_dilation(~inside)
    return np.asarray(ndimage.binary_dilation((np.abs(below) < error) | edge, iterations=2))
