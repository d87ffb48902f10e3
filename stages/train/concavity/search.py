"""How far below the surface the photographs place it: a depth sweep over even samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pipeline.geometry.rays import RayMesh

from ..initialise.hull import HullMesh
from ..initialise.sampling import sample_evenly
from .depths import LEAST_VIEWS, sample_depths
from .explanation import Shading, unexplained
from .samples import Observations, ViewImage, observe

SAMPLES = 5000
DEEPEST = 0.25  # of the object's half-size: deeper concavities are found by going on from shallower ones
FIRST = 0.01  # smallest depth that is tried
GROWTH = 1.25  # of the depths' steps
FACING = 0.38  # cosine to the surface above which a view takes part: at grazing view a depth moves the pixel too far
SHALLOW = 0.01  # depth that counts as none: the sweep's own resolution
CERTAIN = 0.03  # depth from which a concavity can be certain: reflections of the object in itself fake less
BETTER = 1.3  # by which factor more than that depth the surface so far must leave unexplained
CLUSTER, AGREE = 7, 0.5  # a sample and its nearest, and the share of them that must say the same
FEWEST = 10  # samples of one concavity that must be certain: half a dozen at a time are where reflections happen to agree
RIM = 4.0  # sample spacings about a certain concavity within which other depths belong to it
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
    sure = certain(samples.points, found, depths, np.array(residual), np.array(views))
    return SurfaceDepths(samples.points, samples.normals, without_doubtful(samples.points, found, sure, samples.spacing))


def certain(points: np.ndarray, found: np.ndarray, depths: np.ndarray, residual: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Which samples [P] lie deeper beyond doubt: well below the surface, explained better there, and among others like them.

    points [P, 3]; found [P]: their depths; depths [L] that were tried, with `unexplained` and number of views there [L, P].
    """
    seen = (views[0] >= LEAST_VIEWS) & np.isfinite(residual[0])
    rows = np.arange(len(points))
    at = np.abs(depths[:, None] - found).argmin(0)
    there = np.where(views[at, rows] >= LEAST_VIEWS, residual[at, rows], np.inf)
    sure = seen & (found > CERTAIN) & (residual[0] > BETTER * there)
    nearest = cKDTree(points).query(points, k=min(CLUSTER, len(points)))[1].reshape(len(points), -1)
    return np.asarray(sure & (sure[nearest].mean(1) >= AGREE))


def without_doubtful(points: np.ndarray, depths: np.ndarray, sure: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """The depths [P], 0 where they are shallow or lie away from all that are certain (`sure` [P])."""
    reach = RIM * float(np.median(spacing))
    sure = sure & _together(points, sure, reach)
    if not sure.any():
        return np.zeros_like(depths)
    away = cKDTree(points[sure]).query(points)[0]
    return np.where((depths > SHALLOW) & (away <= reach), depths, 0.0)


def _together(points: np.ndarray, sure: np.ndarray, reach: float) -> np.ndarray:
    """Which samples [P] are among FEWEST certain ones or more that hang together within `reach`."""
    out = np.zeros(len(points), bool)
    rows = np.flatnonzero(sure)
    if len(rows) >= FEWEST:
        i, j = cKDTree(points[rows]).query_pairs(reach, output_type="ndarray").T
        links = sparse.coo_matrix((np.ones(len(i), bool), (i, j)), (len(rows), len(rows)))
        _, part = connected_components(links, directed=False)
        out[rows] = np.bincount(part)[part] >= FEWEST
    return out


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
