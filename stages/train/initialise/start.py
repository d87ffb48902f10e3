"""Which surface training starts from: the masks' visual hull, sparse points, or the hull cut down to the points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.errors import UserError
from pipeline.geometry.silhouette_hull import Silhouette, bounds, occupancy, signed_distance

from .hull import HullMesh, visual_hull
from .points import OrientedPoints, PointSurface, orient

FEWEST_POINTS = 200  # fewer do not show a shape
DENSE = 0.055  # spacing over the half-size below which points beat a hull: at 0.04 to 0.05 they mend the hollows of a bunny
# and of Cheburashka, at 0.06 to 0.07 they bend as many normals as they mend
DEEP, HOLLOW = 0.03, 0.02  # a hull in which a fiftieth of the points lie deeper than 3 % of the half-size has hollows to cut;
# 0 to 0.4 % do in those of a teapot and of Spot, 8 to 13 % in those of Cheburashka and a bunny
SMALLEST = 0.05  # of the object's half-size: points of less extent show a detail of it
OUTSIDE = 3.0  # pixels by which a good point may lie outside the silhouettes


@dataclass(frozen=True)
class StartSurface:
    """Mesh, centre [3] and half-size in the silhouettes' world; `points`: whether they had a part in it, and why (not)."""

    mesh: HullMesh
    centre: np.ndarray
    half: float
    points: bool
    reason: str


def start_surface(
    silhouettes: Sequence[Silhouette], points: np.ndarray, choice: str, masked: bool, resolution: int, offset: float
) -> StartSurface:
    """The surface to start from. `choice`: auto, hull or points; `masked`: whether the silhouettes are the object's (else
    they are the pictures' frames). Raises UserError where points are asked for that are not there."""
    cloud, reason = _cloud(silhouettes, points, choice, masked)
    if cloud is None:
        mesh, centre, half = visual_hull(silhouettes, resolution, offset)
        return StartSurface(mesh, centre, half, False, reason)
    surface = PointSurface(cloud, fades=masked)
    mesh, centre, half = visual_hull(silhouettes, resolution, offset, within=surface)
    return StartSurface(mesh, centre, half, True, reason)


def _cloud(
    silhouettes: Sequence[Silhouette], points: np.ndarray, choice: str, masked: bool
) -> tuple[OrientedPoints | None, str]:
    """The points to use, or None, and the reason."""
    if choice == "hull":
        return None, "the hull was asked for"
    points = np.unique(points, axis=0)
    inside = points[_depths(silhouettes, points) > -OUTSIDE] if len(points) else points
    if len(inside) < FEWEST_POINTS:
        found = f"{len(inside)} points on the object, {FEWEST_POINTS} needed" if len(points) else "no points"
        if choice == "points":
            raise UserError("points.ply", found, "set train.start to auto, or poses.triangulate to true to find points")
        return None, found
    cloud = orient(inside, np.array([s.camera.centre for s in silhouettes]))
    half = 0.5 * float((np.percentile(cloud.points, 99, 0) - np.percentile(cloud.points, 1, 0)).max())
    if half < SMALLEST * bounds(silhouettes)[1]:
        return None, f"{len(points)} points, all in one place"
    apart = f"{len(cloud.points)} of {len(points)} points, {100 * cloud.spacing / half:.1f} % of the half-size apart"
    if choice == "auto" and masked and cloud.spacing > DENSE * half:
        return None, f"{apart}: the hull is better than points more than {100 * DENSE:g} % apart"
    if choice == "auto" and masked:
        deeper = float((_depths(silhouettes, cloud.points) * _pixel(silhouettes) > DEEP * half).mean())
        if deeper < HOLLOW:
            return None, f"{apart}: {100 * deeper:.1f} % of them lie below the hull, it has no hollows to cut"
    return cloud, apart


def _depths(silhouettes: Sequence[Silhouette], points: np.ndarray) -> np.ndarray:
    """How deep in the silhouettes' hull the points lie (pixels) [N], negative outside."""
    distances = [signed_distance(s.mask) for s in silhouettes]
    return occupancy(silhouettes, distances, points) / _pixel(silhouettes)


def _pixel(silhouettes: Sequence[Silhouette]) -> float:
    """A pixel's usual width on the object, world units."""
    centre, _ = bounds(silhouettes)
    return float(np.median([np.linalg.norm(s.camera.centre - centre) / s.camera.fx for s in silhouettes]))
