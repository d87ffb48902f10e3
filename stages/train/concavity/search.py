"""How far below the surface the photographs place it: a depth sweep over even samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pipeline.geometry.rays import RayMesh

from ..initialise.hull import HullMesh
from ..initialise.sampling import sample_evenly
from .depths import sample_depths
from .explanation import Shading, unexplained
from .samples import Observations, ViewImage, observe

SAMPLES = 5000
DEEPEST = 0.25  # of the object's half-size: deeper concavities are found by going on from shallower ones
FIRST = 0.01  # smallest depth that is tried
GROWTH = 1.25  # of the depths' steps
FACING = 0.38  # cosine to the surface above which a view takes part: at grazing view a depth moves the pixel too far
CERTAIN = 0.03  # depth that must be found somewhere for a concavity: unmodelled reflections fake less than that
SHALLOW = 0.01  # depth that counts as none beside a certain concavity: the sweep's own resolution
RIM = 4.0  # sample spacings about a certain concavity within which shallower depths belong to it
START = 0.01  # how far off the surface rays towards the cameras begin: half a voxel of the hull


@dataclass(frozen=True)
class SurfaceDepths:
    """Samples of a surface with how far below it the photographs place the object (0: they do not)."""

    points: np.ndarray
    normals: np.ndarray
    depths: np.ndarray

    @property
    def share(self) -> float:
        """Share of the surface that lies deeper."""
        return float((self.depths > 0).mean())


def trial_depths() -> np.ndarray:
    """0 and growing steps down to DEEPEST."""
    depths, step = [0.0], FIRST
    while depths[-1] < DEEPEST:
        depths.append(depths[-1] + step)
        step *= GROWTH
    return np.array(depths)


def surface_depths(
    mesh: HullMesh,
    images: Sequence[ViewImage],
    shading: Shading,
    splat_points: np.ndarray,
    splat_albedo: np.ndarray,
    seed: int,
) -> SurfaceDepths:
    """Sweep samples of the mesh inwards.

    Args:
        mesh: the surface so far, training frame.
        images: the training views as lookups.
        shading: light and material so far.
        splat_points, splat_albedo: the model so far, for the albedo to fall back on. [N, 3]
        seed: of the sampling.
    """
    samples = sample_evenly(mesh, SAMPLES, np.random.default_rng(seed))
    albedo = splat_albedo[cKDTree(splat_points).query(samples.points)[1]]
    sight = _Sight(mesh, images)
    depths = trial_depths()
    residual, views = [], []
    for depth in depths:
        seen = sight.observe(samples.points, samples.normals, depth)
        residual.append(unexplained(seen, albedo, shading))
        views.append(seen.views)
    found = sample_depths(samples.points, samples.normals, depths, np.array(residual), np.array(views))
    return SurfaceDepths(samples.points, samples.normals, without_doubtful(samples.points, found, samples.spacing))


def without_doubtful(points: np.ndarray, depths: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """The depths [P], 0 where they are shallow and not at the rim of a concavity that is certain."""
    certain = depths > CERTAIN
    if not certain.any():
        return np.zeros_like(depths)
    away = cKDTree(points[certain]).query(points)[0]
    return np.where((depths > SHALLOW) & (away <= RIM * np.median(spacing)), depths, 0.0)


class _Sight:
    """Which views see a point at a depth below the mesh, if the matter right above it were gone."""

    def __init__(self, mesh: HullMesh, images: Sequence[ViewImage]) -> None:
        self.images = images
        self.solid = RayMesh(mesh.vertices, mesh.triangles)

    def observe(self, surface: np.ndarray, normals: np.ndarray, depth: float) -> Observations:
        """What the views saw of the points `depth` below the surface points."""
        points = surface - depth * normals
        centres = np.array([image.camera.centre for image in self.images])
        towards = centres[:, None] - points
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        visible = (towards * normals).sum(-1) > FACING
        k, p = np.nonzero(visible)
        origins = points[p] + (START * normals[p] if depth == 0 else 0.0)
        first = self.solid.distance(origins, towards[k, p])
        if depth == 0:
            free = ~np.isfinite(first)
        else:  # out through the surface above, and never in again
            free = (self.solid.crossings(origins, towards[k, p]) == 1) & (first < depth / FACING + START)
        visible[k, p] = free
        return observe(self.images, points, visible, towards.astype(np.float32))
