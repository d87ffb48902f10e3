"""Cut the openings that the views look into out of a start surface, a few pixels deep and finer than the hull's own voxels.

The masks cover an opening: the hull closes it with a film, and rounds its rims off by a voxel or two. But where a pixel of an
opening looks, nothing faces the camera for a while. What is cut away leaves the rims' inner sides as walls; the floor where
the cut ends is none of the object's surface and is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from pipeline.geometry.cameras import Camera
from pipeline.geometry.rays import RayMesh
from pipeline.geometry.silhouette_hull import signed_distance

from .hull import HullMesh, smoothed

DEPTH = 4.0  # pixels that are cut away along a viewing ray: a wall deeper down hides in the next view already
VOXEL = 0.5  # pixels
SMOOTH = 0.4  # pixels by which the cut surface is blurred
REACH = DEPTH + 2.0  # pixels about the openings' film that are meshed anew
MOST_VOXELS = 12_000_000  # beyond, the voxels grow
AGREE = 2  # views that must look through a point: one alone may have a dead patch
UNSURE = 4.0  # pixels from the mesh within which `solid` is asked: thin tips of a hull are lost by that much
CLEARLY = 0.5  # pixels inside an opening from which a view surely looks through it
FACING = 0.1  # cosine above which a view judges the film


Field = Callable[[np.ndarray], np.ndarray]  # signed distance [M] at points [M, 3], positive inside


@dataclass(frozen=True)
class OpeningView:
    """A view's camera and how far each of its pixels looks into an opening: 0 not at all .. 1 wholly [H, W]."""

    camera: Camera
    hole_coverage: NDArray[np.float64]


def cut_openings(mesh: HullMesh, views: Sequence[OpeningView], pixel: float, solid: Field | None = None) -> HullMesh | None:
    """The mesh without what the openings look through, or None where no two views look through one place.

    pixel: a pixel's width on the object, in the mesh's units, which are the cameras' too. solid: signed distance to what
    the mesh stands for, if that is known more finely than by the mesh.
    """
    from skimage.measure import marching_cubes

    ray = _Rays(mesh, views, pixel)
    film = mesh.vertices[ray.film(mesh)]
    if len(film) < 3:
        return None
    tree = cKDTree(film)
    low, high = film.min(0) - (REACH + 3) * pixel, film.max(0) + (REACH + 3) * pixel
    step = max(VOXEL * pixel, float((np.prod(high - low) / MOST_VOXELS) ** (1 / 3)))
    shape = np.ceil((high - low) / step).astype(int) + 1
    coarse = max(1, round(pixel / step))
    near = _near(tree, low, step, shape, coarse, (REACH + 2) * pixel)
    points = low + step * np.argwhere(near)
    inside = ray.inside(points)
    if solid is not None:
        unsure = np.abs(inside) < UNSURE * pixel
        inside[unsure] = solid(points[unsure])
    deep = inside > -pixel
    free = np.full(len(points), -1e3 * pixel)
    free[deep] = ray.looked_through(points[deep])
    values = np.full(tuple(shape), -pixel, np.float32)
    values[near] = np.clip(np.minimum(inside, -free), -pixel, pixel)
    values = ndimage.gaussian_filter(values, SMOOTH * pixel / step)
    if not (values[near] > 0).any() or not (values[near] < 0).any():
        return None  # nothing is left there, or nothing is cut
    vertices, triangles, *_ = marching_cubes(values, 0.0, spacing=(step,) * 3, mask=near)
    fine = smoothed(vertices + low, triangles[:, ::-1].astype(np.int64), rounds=3)
    outside = tree.query(mesh.vertices[mesh.triangles].mean(1))[0] > REACH * pixel
    within = tree.query(fine.vertices[fine.triangles].mean(1))[0] <= REACH * pixel
    count = len(mesh.vertices)
    cut = HullMesh(
        np.concatenate([mesh.vertices, fine.vertices]),
        np.concatenate([mesh.triangles[outside], fine.triangles[within] + count]),
        np.concatenate([mesh.normals, fine.normals]),
    )
    hidden = np.zeros(len(cut.vertices), bool)
    hidden[count:] = ~_Rays(cut, views, pixel).shown(fine.vertices, fine.normals)
    return HullMesh(cut.vertices, cut.triangles[~hidden[cut.triangles].any(1)], cut.normals)


def _near(tree: cKDTree, low: np.ndarray, step: float, shape: np.ndarray, coarse: int, reach: float) -> NDArray[np.bool_]:
    """Voxels within `reach` of the film, tested on every `coarse`-th."""
    axes = [low[k] + step * np.arange(0, shape[k] + coarse, coarse) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    close = tree.query(grid.reshape(-1, 3), distance_upper_bound=reach)[0].reshape(grid.shape[:3]) < np.inf
    for axis in range(3):
        close = np.repeat(close, coarse, axis)
    return close[: shape[0], : shape[1], : shape[2]]


class _Rays:
    """The views' rays against the mesh."""

    def __init__(self, mesh: HullMesh, views: Sequence[OpeningView], pixel: float) -> None:
        self.solid = RayMesh(mesh.vertices, mesh.triangles)
        self.views = views
        self.distances = [signed_distance(v.hole_coverage, blur=0.35) for v in views]
        self.pixel = pixel

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Distance to the mesh [M], positive inside."""
        return self.solid.signed_distance(points)

    def film(self, mesh: HullMesh) -> NDArray[np.bool_]:
        """Vertices that two views see with an opening behind them or beside."""
        votes = np.zeros(len(mesh.vertices), int)
        for view, distance in zip(self.views, self.distances):
            towards = view.camera.centre - mesh.vertices
            facing = (mesh.normals * towards).sum(-1) > FACING * np.linalg.norm(towards, axis=-1)
            rows = np.flatnonzero(facing)
            rows = rows[_at(view.camera, distance, mesh.vertices[rows]) > -1.0]
            votes[rows[np.abs(self._below(view.camera, mesh.vertices[rows])) < self.pixel]] += 1
        return votes >= AGREE

    def looked_through(self, points: np.ndarray) -> np.ndarray:
        """How far inside the space that AGREE views look through points lie, down to DEPTH [M]."""
        best = np.full((AGREE, len(points)), -1e3 * self.pixel)
        for view, distance in zip(self.views, self.distances):
            across = _at(view.camera, distance, points) * self.pixel
            rows = np.flatnonzero(across > -2 * self.pixel)
            value = np.minimum(across[rows], DEPTH * self.pixel - self._below(view.camera, points[rows]))
            best[:, rows] = -np.sort(-np.concatenate([best[:, rows], value[None]]), 0)[:AGREE]
        return best[-1]

    def shown(self, points: np.ndarray, normals: np.ndarray) -> NDArray[np.bool_]:
        """Whether AGREE views see points of the mesh from outside, and no more views look through an opening there."""
        votes, against = np.zeros(len(points), int), np.zeros(len(points), int)
        for view, distance in zip(self.views, self.distances):
            towards = view.camera.centre - points
            rows = np.flatnonzero((normals * towards).sum(-1) > FACING * np.linalg.norm(towards, axis=-1))
            rows = rows[self._below(view.camera, points[rows]) < 0.5 * self.pixel]
            looks = _at(view.camera, distance, points[rows])
            votes[rows[looks < 0]] += 1
            against[rows[looks > CLEARLY]] += 1
        return (votes >= AGREE) & (votes > against)

    def _below(self, camera: Camera, points: np.ndarray) -> np.ndarray:
        """How far behind the first surface that the camera sees in their direction points lie [M]."""
        offset = points - camera.centre
        distance = np.linalg.norm(offset, axis=-1)
        return distance - self.solid.distance(camera.centre, offset / distance[:, None])


def _at(camera: Camera, image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values [M] of an image where points project, far below any outside it."""
    pixels, z = camera.project(points)
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        seen = (z > 0) & (pixels >= 0).all(-1) & (pixels[:, 0] <= width) & (pixels[:, 1] <= height)
    out = np.full(len(points), -1e3)
    at = pixels[seen]
    out[seen] = ndimage.map_coordinates(image, [at[:, 1] - 0.5, at[:, 0] - 0.5], order=1, mode="nearest")
    return out
