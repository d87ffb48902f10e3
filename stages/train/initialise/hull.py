"""Visual hull of the masks as a signed-distance grid and a smooth triangle mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse

from pipeline.errors import UserError
from pipeline.geometry.normals import vertex_normals
from pipeline.geometry.silhouette_hull import Silhouette, bounds, grid, occupancy, signed_distance

from .points import PointSurface

SMALLEST_PART = 0.02  # parts with less than this share of the largest part's volume are carving debris


@dataclass(frozen=True)
class HullMesh:
    """Vertices [V, 3], triangles [T, 3], unit outward vertex normals [V, 3], in the silhouettes' world."""

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray


def visual_hull(
    silhouettes: Sequence[Silhouette],
    resolution: int,
    offset: float = 0.0,
    outvoted: int = 0,
    within: PointSurface | None = None,
) -> tuple[HullMesh, np.ndarray, float]:
    """The hull's mesh and its bounding box's centre [3] and largest half extent.

    `resolution`: voxels along the longest side. `offset`: pixels by which the object exceeds its masks. `within`: a surface
    that cuts the hull down, but for what the silhouettes need if they are the object's (`within.fades`). Raises UserError
    where the masks have no common object.
    """
    distances = [signed_distance(s.mask, offset) for s in silhouettes]
    centre, half = bounds(silhouettes)
    half *= 1.3
    coarse, coarse_shape = grid(centre - half, centre + half, 2 * half / 40)
    near = outer = without_debris(occupancy(silhouettes, distances, coarse, outvoted).reshape(coarse_shape))
    if within is not None:
        near = without_debris(within.cut(coarse, near.ravel()).reshape(coarse_shape))
        outer = outer if within.fades else near
    kept = coarse[outer.ravel() > -2 * half / 40]
    if len(kept) < 2 or (near > 0).sum() < 2:
        raise UserError("masks", "they have no object in common", "check the masks, the cameras and their pairing")
    margin = 2 * half / 40
    low, high = kept.min(0) - margin, kept.max(0) + margin
    spacing = float((high - low).max()) / resolution
    points, shape = grid(low, high, spacing)

    def looked_up(field: np.ndarray) -> np.ndarray:
        return ndimage.map_coordinates(field, ((points - (centre - half)) / (2 * half / 40)).T, order=1, mode="nearest")

    # the coarse field tells what is far from the surface
    values = looked_up(near).astype(np.float32)
    band = np.abs(values) < 4 * half / 40
    if within is not None and within.fades:
        band |= np.abs(looked_up(outer)) < 4 * half / 40
    values[band] = occupancy(silhouettes, distances, points[band], outvoted)
    if within is not None:
        hull, place = values[band], points[band]
        values[band] = within.cut(place, hull)
        if within.fades:
            restored = needed(silhouettes, place, hull, values[band])
            values[band] = np.where(restored, hull, values[band])
    volume = ndimage.gaussian_filter(values.reshape(shape), 0.8)
    volume = without_debris(np.pad(volume, 1, constant_values=-spacing))
    if not (volume > 0).any():
        raise UserError("masks", "the common object is too thin to see", "check the masks and the cameras")
    return _surface(volume, low, spacing)


def _surface(volume: np.ndarray, low: np.ndarray, spacing: float) -> tuple[HullMesh, np.ndarray, float]:
    """Smoothed zero level of a volume whose second voxel is at `low`, its bounding box's centre [3] and largest half extent."""
    from skimage.measure import marching_cubes

    vertices, triangles, *_ = marching_cubes(volume, 0.0, spacing=(spacing,) * 3)
    mesh = smoothed(vertices + low - spacing, triangles[:, ::-1].astype(np.int64), rounds=6)
    top, bottom = mesh.vertices.max(0), mesh.vertices.min(0)
    return mesh, 0.5 * (top + bottom), float(0.5 * (top - bottom).max())


def needed(silhouettes: Sequence[Silhouette], points: np.ndarray, hull: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """Which of the points [M, 3] that a cut takes from the hull (signed distances [M]) a silhouette would then lack [M].

    Thin parts go first where sparse points are noisy; their silhouettes are better evidence.
    """
    solid, taken = np.flatnonzero(cut > 0), np.flatnonzero((hull > 0) & (cut <= 0))
    out = np.zeros(len(points), bool)
    for s in silhouettes:
        covered = np.zeros(s.mask.shape, bool)
        _, row, column = _pixels(s, points, solid)
        covered[row, column] = True
        # twice: gaps between voxels wider apart than pixels, and what a silhouette's own edge leaves open
        bare = (s.mask > 0.5) & ~ndimage.binary_dilation(covered, iterations=2)
        if bare.any():
            which, row, column = _pixels(s, points, taken)
            out[which[ndimage.binary_dilation(bare, iterations=3)[row, column]]] = True
    return out


def _pixels(silhouette: Silhouette, points: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Those of the points `which` that lie in a view's frame, with their pixels' rows and columns."""
    height, width = silhouette.mask.shape
    pixels, z = silhouette.camera.project(points[which])
    inside = (z > 0) & (pixels >= 0).all(-1) & (pixels < (width, height)).all(-1)
    column, row = pixels[inside].astype(np.int64).T
    return which[inside], row, column


def without_debris(volume: np.ndarray) -> np.ndarray:
    """The signed-distance volume with small positive islands turned negative."""
    parts, count = ndimage.label(volume > 0)
    if count <= 1:
        return volume
    sizes = ndimage.sum_labels(volume > 0, parts, np.arange(1, count + 1))
    small = np.isin(parts, 1 + np.flatnonzero(sizes < SMALLEST_PART * sizes.max()))
    return np.where(small, -np.abs(volume), volume)


def smoothed(vertices: np.ndarray, triangles: np.ndarray, rounds: int) -> HullMesh:
    """Taubin smoothing (0.5, -0.53), which takes the stair steps away without shrinking, and vertex normals."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = len(vertices)
    ones = np.ones(len(edges))
    links = sparse.coo_matrix((ones, (edges[:, 0], edges[:, 1])), (count, count))
    links = ((links + links.T) > 0).astype(np.float64)
    average = sparse.diags(1.0 / np.maximum(np.asarray(links.sum(1)).ravel(), 1)) @ links
    v = vertices.astype(np.float64)
    for _ in range(rounds):
        for step in (0.5, -0.53):
            v = v + step * (average @ v - v)
    return HullMesh(v, triangles, vertex_normals(v, triangles))
