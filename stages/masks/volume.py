"""Scores of voxels from scores of pixels, and back: the visual hull with doubt.

Kernels are single loops over a cubic grid; every view's score of a voxel is that of the pixel its centre falls on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.kernels.compiling import kernel

NOTHING = -1e9
"""Score of a ray that misses the grid."""


@dataclass(frozen=True)
class Grid:
    """A cube of `count`^3 voxels from the corner `low` [3], edge of a voxel `step` (world units)."""

    low: NDArray[np.float64]
    step: float
    count: int


@dataclass(frozen=True)
class Projections:
    """All views' pinhole matrices as arrays: world to pixel [V, 3, 4], pixel to ray [V, 3, 3], centres, sizes (w, h)."""

    forward: NDArray[np.float64]
    back: NDArray[np.float64]
    centres: NDArray[np.float64]
    sizes: NDArray[np.int64]

    @classmethod
    def of(cls, cameras: list[Camera]) -> Projections:
        """From cameras; lens distortion is left out (a fraction of a voxel at this resolution)."""
        forward = np.stack([c.intrinsics @ c.world_to_camera[:3] for c in cameras])
        back = np.stack([c.world_to_camera[:3, :3].T @ np.linalg.inv(c.intrinsics) for c in cameras])
        sizes = np.array([[c.width, c.height] for c in cameras], np.int64)
        return cls(forward, back, np.stack([c.centre for c in cameras]), sizes)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(views, height, width) that holds every view."""
        return len(self.sizes), int(self.sizes[:, 1].max()), int(self.sizes[:, 0].max())


def stack_padded(images: list[NDArray], dtype: type = np.float32) -> NDArray:
    """Images [h, w] of any sizes as one array [V, H, W], zero where an image ends."""
    out = np.zeros((len(images), max(i.shape[0] for i in images), max(i.shape[1] for i in images)), dtype)
    for k, image in enumerate(images):
        out[k, : image.shape[0], : image.shape[1]] = image
    return out


def voxel_scores(pixel_scores: NDArray[np.float32], projections: Projections, grid: Grid) -> NDArray[np.float32]:
    """Sum over views of the pixel scores [V, H, W] at every voxel centre, [N, N, N] (z, y, x); outside an image: 0."""
    out = np.zeros((grid.count,) * 3, np.float32)
    _gather(pixel_scores, projections.forward, projections.sizes, grid.low, grid.step, out)
    return out


def ray_maxima(
    volume: NDArray[np.float32], wanted: NDArray[np.bool_], projections: Projections, grid: Grid
) -> NDArray[np.float32]:
    """Largest voxel score along the ray of each wanted pixel, [V, H, W]; NOTHING elsewhere and where the grid is missed."""
    out = np.full(wanted.shape, NOTHING, np.float32)
    _march(volume, wanted, projections.back, projections.centres, projections.sizes, grid.low, grid.step, out)
    return out


@kernel
def pixel_of(p, x, y, z):
    """Column and row of the pixel that a point falls on under the pinhole matrix p [3, 4]; (-1, -1) behind the camera."""
    depth = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
    if depth <= 0:
        return -1, -1
    u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) / depth
    t = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) / depth
    return int(np.floor(u)), int(np.floor(t))


@kernel(parallel=True)
def _gather(scores, forward, sizes, low, step, out):
    n = out.shape[0]
    for plane in prange(n):
        z = low[2] + (plane + 0.5) * step
        for row in range(n):
            y = low[1] + (row + 0.5) * step
            for column in range(n):
                x = low[0] + (column + 0.5) * step
                total = 0.0
                for v in range(forward.shape[0]):
                    u, t = pixel_of(forward[v], x, y, z)
                    if 0 <= u < sizes[v, 0] and 0 <= t < sizes[v, 1]:
                        total += scores[v, t, u]
                out[plane, row, column] = total


@kernel(parallel=True)
def _march(volume, wanted, back, centres, sizes, low, step, out):
    n = volume.shape[0]
    edge = n * step
    for job in prange(out.shape[0] * out.shape[1]):
        v, t = job // out.shape[1], job % out.shape[1]
        if t >= sizes[v, 1]:
            continue
        origin = centres[v] - low
        for u in range(sizes[v, 0]):
            if not wanted[v, t, u]:
                continue
            b = back[v]
            d0 = b[0, 0] * (u + 0.5) + b[0, 1] * (t + 0.5) + b[0, 2]
            d1 = b[1, 0] * (u + 0.5) + b[1, 1] * (t + 0.5) + b[1, 2]
            d2 = b[2, 0] * (u + 0.5) + b[2, 1] * (t + 0.5) + b[2, 2]
            length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
            direction = (d0 / length, d1 / length, d2 / length)
            near, far = 0.0, 1e30
            for a in range(3):
                if abs(direction[a]) < 1e-12:  # parallel to the slab: inside it or never
                    if origin[a] < 0 or origin[a] > edge:
                        far = -1.0
                else:
                    first, second = -origin[a] / direction[a], (edge - origin[a]) / direction[a]
                    near, far = max(near, min(first, second)), min(far, max(first, second))
            best = out[v, t, u]
            s = near + 0.25 * step
            while s < far:
                i = int((origin[0] + s * direction[0]) / step)
                j = int((origin[1] + s * direction[1]) / step)
                k = int((origin[2] + s * direction[2]) / step)
                if 0 <= i < n and 0 <= j < n and 0 <= k < n and volume[k, j, i] > best:
                    best = volume[k, j, i]
                s += 0.7 * step  # a voxel that the ray crosses by more than this is met
            out[v, t, u] = best
