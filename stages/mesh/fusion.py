"""Truncated signed distance from depth images: Curless and Levoy 1996, along normals instead of rays, with carving.

Open3D keeps the sparse blocks and extracts the surface; the fusion itself is here because a view should count by how
squarely and how closely it sees a point, and because its built-in one samples depth at the nearest pixel.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry import fusion_kernel

from .gbuffer import DepthView

BLOCK = 8  # voxels along a block's edge
FREE_WEIGHT = 0.5  # of a ray that misses the object, against a surface seen squarely
SAMPLED = 20_000  # points of a view from which its extent is taken
LEAST_WEIGHT = 0.02  # a voxel seen only at grazing angles by one view says too little


@dataclass(frozen=True)
class Extent:
    """The object as the depths show it: corners [3] each, longest side, and the median footprint of a pixel on it."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    footprint: float

    @property
    def size(self) -> float:
        """Longest side in world units."""
        return float((self.high - self.low).max())


def points_of(view: DepthView) -> NDArray[np.float64]:
    """World points [N, 3] of the pixels with depth."""
    c = view.camera
    row, column = np.nonzero(view.depth)
    z = view.depth[row, column].astype(np.float64)
    local = np.stack([(column + 0.5 - c.cx) / c.fx * z, (row + 0.5 - c.cy) / c.fy * z, z], -1)
    return (local - c.world_to_camera[:3, 3]) @ c.world_to_camera[:3, :3]


def measure(views: Iterable[DepthView]) -> Extent:
    """Extent of the object, a thousandth of outlying points left out on every side."""
    points, footprints = [], []
    for view in views:
        if view.depth.any():
            found = points_of(view)
            points.append(found[:: max(1, len(found) // SAMPLED)])
            footprints.append(np.median(view.depth[view.depth > 0]) / np.sqrt(view.camera.fx * view.camera.fy))
    low, high = np.quantile(np.concatenate(points), [0.001, 0.999], axis=0)
    return Extent(low, high, float(np.median(footprints)))


class Volume:
    """A sparse signed distance field around the back-projected depths."""

    def __init__(self, views: Iterable[DepthView], extent: Extent, voxel: float, truncation: float) -> None:
        import open3d as o3d

        self.voxel, self.truncation = voxel, truncation
        float32 = o3d.core.float32
        near = _BlocksNear(extent, voxel, truncation)
        for view in views:
            near.mark(points_of(view))
        touched = near.blocks()
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (float32, float32), ((1), (1)), voxel, BLOCK, len(touched), o3d.core.Device("CPU:0")
        )
        self._grid.hashmap().activate(o3d.core.Tensor(touched))
        indices = self._grid.hashmap().active_buf_indices()
        coordinates, flat = self._grid.voxel_coordinates_and_flattened_indices(indices)
        self._points = np.ascontiguousarray(coordinates.numpy(), np.float32)
        self._flat, self._weighed = flat, False  # whether the grid holds the weights
        self._distance = np.zeros(len(self._points), np.float32)  # in truncations
        self._weight = np.zeros(len(self._points), np.float32)

    def integrate(self, view: DepthView, grazing: float) -> None:
        """Blend one view's depth in; rays that miss the object carve."""
        self._weighed = False
        c = view.camera
        pinhole = (c.fx, c.fy, c.cx, c.cy)
        pose = (np.ascontiguousarray(c.world_to_camera), np.ascontiguousarray(c.centre))
        images = (np.ascontiguousarray(view.depth), np.ascontiguousarray(view.normal))
        state = (self._points, self._distance, self._weight)
        fusion_kernel.integrate(*state, *images, *pose, *pinhole, self.truncation, grazing, FREE_WEIGHT)

    def extract(self, outward: float = 0.0) -> Any:
        """The surface at a distance `outward` from the zero crossing, as an Open3D tensor mesh (possibly empty)."""
        import open3d as o3d

        fields = {"tsdf": self._distance - np.float32(outward / self.truncation)}
        if not self._weighed:
            fields["weight"], self._weighed = self._weight, True
        for name, values in fields.items():
            field = self._grid.attribute(name).reshape((-1, 1))
            field[self._flat] = o3d.core.Tensor(values[:, None])
        return self._grid.extract_triangle_mesh(weight_threshold=LEAST_WEIGHT)


class _BlocksNear:
    """The blocks within a truncation of any point, marked in a dense grid over the object's extent and a margin."""

    def __init__(self, extent: Extent, voxel: float, truncation: float) -> None:
        self._edge, self._reach, margin = BLOCK * voxel, truncation + voxel, 4 * truncation
        self._low, self._high = extent.low - margin, extent.high + margin
        self._first = np.floor((self._low - self._reach) / self._edge).astype(np.int64)
        last = np.floor((self._high + self._reach) / self._edge).astype(np.int64)
        self._marked = np.zeros(last - self._first + 1, bool)

    def mark(self, points: NDArray[np.float64]) -> None:
        """Mark the blocks near points [N, 3]; points outside the extent and its margin are stray."""
        points = points[((points > self._low) & (points < self._high)).all(1)]
        steps = (-self._reach, 0.0, self._reach)
        x, y, z = (
            [np.floor((points[:, k] + step) / self._edge).astype(np.int64) - self._first[k] for step in steps] for k in range(3)
        )
        for i, j, k in itertools.product(x, y, z):
            self._marked[i, j, k] = True

    def blocks(self) -> NDArray[np.int32]:
        """Sorted coordinates [B, 3] of the marked blocks."""
        return (np.argwhere(self._marked) + self._first).astype(np.int32)
