"""One closed surface out of all cameras' distances: fused where a camera sees it, the silhouettes' hull where none does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.geometry import fusion_kernel
from pipeline.geometry.mesh import Mesh
from pipeline.geometry.silhouette_hull import Silhouette, bounds, grid, grid_axes, occupancy, signed_distance

from .map_view import MapView

Float = NDArray[np.float64]
FREE_WEIGHT = 0.5  # of a ray that misses the object, against a surface seen squarely
CHUNK = 2_000_000  # grid points judged together


@dataclass(frozen=True)
class Hull:
    """The silhouettes' hull: signed distances (world units, positive inside) on a cubic grid that begins at `low`."""

    low: Float
    spacing: float
    values: NDArray[np.float32]

    def at(self, points: Float) -> NDArray[np.float32]:
        """Signed distances at points [N, 3]."""
        return ndimage.map_coordinates(self.values, ((points - self.low) / self.spacing).T, order=1, mode="nearest")

    def box(self) -> tuple[Float, Float]:
        """Corners of what lies inside."""
        inside = np.argwhere(self.values > 0)
        return self.low + self.spacing * inside.min(0), self.low + self.spacing * inside.max(0)


def silhouettes_of(views: Sequence[MapView]) -> list[Silhouette]:
    """The views' masks with their cameras, and empty frame about each, as wide as the mask is large, on the sides that it does
    not reach: views are cut to the object, and what lies beside it is off it."""
    return [_with_empty_border(view) for view in views]


def _with_empty_border(view: MapView) -> Silhouette:
    mask, reach = view.mask.astype(np.float32), max(view.mask.shape)
    sides = (mask[0], mask[-1], mask[:, 0], mask[:, -1])
    top, bottom, left, right = (0 if side.any() else reach for side in sides)
    c = view.camera
    camera = replace(c, width=c.width + left + right, height=c.height + top + bottom, cx=c.cx + left, cy=c.cy + top)
    return Silhouette(camera, np.pad(mask, ((top, bottom), (left, right))))


def hull_of(silhouettes: Sequence[Silhouette], resolution: int) -> Hull:
    """The hull on a grid of `resolution` voxels along its longest side. Raises UserError where all masks are empty."""
    distances = [signed_distance(s.mask) for s in silhouettes]
    centre, half = bounds(silhouettes)
    low, high = centre - 1.5 * half, centre + 1.5 * half
    coarse, shape = grid(low, high, 3 * half / 48)
    values = occupancy(silhouettes, distances, coarse).reshape(shape)
    near = coarse.reshape(*shape, 3)[values > -3 * half / 48]
    low, high = (near.min(0), near.max(0)) if len(near) else (low, high)
    margin = 3 * half / 48
    spacing = float((high - low).max()) / resolution
    points, shape = grid(low - margin, high + margin, spacing)
    parts = [occupancy(silhouettes, distances, points[k : k + CHUNK]) for k in range(0, len(points), CHUNK)]
    return Hull(low - margin, spacing, np.concatenate(parts).reshape(shape))


def chords(view: MapView, hull: Hull) -> tuple[Float, Float]:
    """Where each pixel's ray enters and leaves the hull first and last: distances [H, W] twice, 0 where it misses."""
    rays = view.camera.rays()
    low, high = hull.box()
    middle, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) + hull.spacing
    towards = float(np.linalg.norm(middle - view.camera.centre))
    steps = np.arange(max(towards - reach, 0.5 * hull.spacing), towards + reach, hull.spacing)
    near, far = np.zeros(view.mask.shape), np.zeros(view.mask.shape)
    seen = view.mask > 0
    own = rays[seen]
    first, last = np.zeros(len(own)), np.zeros(len(own))
    for t in steps:
        inside = hull.at(view.camera.centre + own * t) > 0
        first = np.where(inside & (first == 0), t, first)
        last = np.where(inside, t, last)
    near[seen], far[seen] = first, last
    return near, far


def fused_volume(
    views: Sequence[MapView], distances: Sequence[Float], hull: Hull, voxel: float, truncation: float, grazing: float
) -> tuple[NDArray[np.float32], Float]:
    """Signed distances (in truncations, positive outside) on a grid of this voxel, and the grid's first point [3].

    Where no camera's ray comes within a truncation of a surface, what lies in the hull and not `_beyond` the seen is inside.
    """
    low, high = hull.box()
    margin = truncation + 2 * voxel
    axes = grid_axes(low - margin, high + margin, voxel)
    shape = tuple(map(len, axes))
    near, place = _near(hull, axes, margin)
    likely = _likely(views, distances, hull, margin)
    distance, weight = np.zeros(len(near), np.float32), np.zeros(len(near), np.float32)
    for view, seen in zip(views, distances):
        camera = view.camera
        depth = seen * (camera.rays() @ camera.world_to_camera[2, :3])
        outside = view.mask <= 0.02
        depth = np.where(outside | (depth > 0), depth, -1.0)  # behind the camera: neither surface nor free space
        fusion_kernel.integrate(
            place, distance, weight, np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(view.normal, np.float32),
            np.ascontiguousarray(camera.world_to_camera), np.ascontiguousarray(camera.centre), camera.fx, camera.fy,
            camera.cx, camera.cy, truncation, grazing, FREE_WEIGHT,
        )  # fmt: skip
    field = np.ones(int(np.prod(shape)), np.float32)
    unseen = weight == 0
    distance[unseen] = np.clip(-likely.at(place[unseen]) / truncation, -1, 1)
    field[near] = distance
    return field.reshape(shape), low - margin


def inscribed_radii(mask: Float) -> Float:
    """Radius in pixels [H, W] of the largest disc that lies in the mask and covers the pixel, 0 outside."""
    inner = ndimage.distance_transform_edt(np.pad(mask > 0.5, 1))[1:-1, 1:-1]
    out = inner.copy()
    for radius in np.arange(1.0, np.floor(inner.max()) + 1):
        covered = ndimage.distance_transform_edt(inner < radius) < radius
        out[covered] = np.maximum(out[covered], radius)
    return out


def _near(hull: Hull, axes: list[Float], margin: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Numbers [N] of a grid's points that lie in the hull or within `margin` of it, and their places [N, 3]: a few layers of
    the grid at a time, for most of it is neither."""
    layer = len(axes[1]) * len(axes[2])
    step = max(1, CHUNK // layer)
    numbers, places = [], []
    for first in range(0, len(axes[0]), step):
        points = np.stack(np.meshgrid(axes[0][first : first + step], axes[1], axes[2], indexing="ij"), -1).reshape(-1, 3)
        found = np.flatnonzero(hull.at(points) > -margin)
        numbers.append(first * layer + found)
        places.append(points[found].astype(np.float32))
    return np.concatenate(numbers), np.concatenate(places)


def _likely(views: Sequence[MapView], distances: Sequence[Float], hull: Hull, margin: float) -> Hull:
    """The hull without what is `_beyond` the seen, on its own grid: a guess need not be finer than what bounds it. Nothing is
    guessed farther outside than `margin`."""
    values = hull.values.ravel().copy()
    within = np.flatnonzero(values > -margin - hull.spacing)
    places = hull.low + hull.spacing * np.stack(np.unravel_index(within, hull.values.shape), -1)
    values[within] = np.minimum(values[within], -_beyond(views, distances, places))
    return Hull(hull.low, hull.spacing, values.reshape(hull.values.shape))


def _beyond(views: Sequence[MapView], distances: Sequence[Float], points: Float) -> Float:
    """How far points [N, 3] that no camera sees are beyond what the seen surface nearest to them makes likely [N].

    No part of an object is farther from its surface than the largest disc that fits into it there: what lies deeper is guessed
    to be empty, whatever the hull leaves open behind the object.
    """
    from scipy.spatial import cKDTree

    found, likely = [], []
    for view, distance in zip(views, distances):
        seen = distance > 0
        found.append(view.camera.centre + view.camera.rays()[seen] * distance[seen][:, None])
        likely.append(inscribed_radii(view.mask)[seen] * distance[seen] / view.camera.fx)
    radii = np.concatenate(likely)
    if not len(radii):
        return np.full(len(points), -np.inf)  # nothing is seen: the hull alone tells
    away, nearest = cKDTree(np.concatenate(found)).query(points, distance_upper_bound=2 * float(radii.max()))
    reached = np.isfinite(away)
    return np.where(reached, away - radii[np.where(reached, nearest, 0)], radii.max())


def extracted(field: NDArray[np.float32], low: Float, voxel: float) -> Mesh:
    """The zero level of a field that is positive outside."""
    from skimage.measure import marching_cubes

    padded = np.pad(field, 1, constant_values=1.0)
    if not (padded < 0).any():
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    vertices, faces, *_ = marching_cubes(-padded, 0.0, spacing=(voxel,) * 3)
    return Mesh(vertices.astype(np.float64) + low - voxel, faces[:, ::-1].astype(np.int64))
