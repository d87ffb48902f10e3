"""The surface that sparse points lie on (COLMAP's, or any other): cleaned, oriented, closed; as a signed distance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from pipeline.formats.ply import Ply
from pipeline.geometry.rays import RayMesh

NEIGHBOURS = 12  # of a local plane: fewer follow the noise, more round off what 1000 points can show
FAR = 2.5  # an outlier's neighbours are further than this many times the usual distance
OFF_PLANE = 4.0  # an outlier is further from its neighbours' plane than this many times the usual distance
ROUNDS = 2  # of cleaning: the first changes what is usual
VOTES = 20  # rounds in which neighbours agree on which side is out
FLIP = 1.5  # log10 of the flipping radius over the cloud's size (Katz et al. 2007); 1 to 2 give the same sides after the votes
SUPPORT = 3.0  # spacings from a point up to which it tells the surface; further off the silhouettes alone do
DEEPER = 0.75  # spacings by which points must lie below the hull to be believed: 0.5 bends more normals than it mends on a
# teapot, 1 leaves more of a bunny's hollows filled
FINEST = 7  # Poisson octree depth: 128 cells, about the hull's


@dataclass(frozen=True)
class OrientedPoints:
    """Points [N, 3], unit outward normals [N, 3], usual distance between neighbours, in one world."""

    points: np.ndarray
    normals: np.ndarray
    spacing: float


def read_points(path: Path) -> np.ndarray:
    """Finite positions float64 [N, 3] of a point PLY; [0, 3] where there is no such file. Raises UserError."""
    if not path.exists():
        return np.zeros((0, 3))
    points = Ply(path).vertices()
    return points[np.isfinite(points).all(-1)]


def orient(points: np.ndarray, centres: np.ndarray) -> OrientedPoints:
    """Outliers out, normals by local planes, turned towards the cameras (`centres` [V, 3]) that see them."""
    for _ in range(ROUNDS):
        distance, index = cKDTree(points).query(points, k=min(NEIGHBOURS + 1, len(points)))
        usual = distance[:, 1:].mean(-1)
        off, _ = _plane(points, index[:, 1:])
        kept = (usual <= FAR * np.median(usual)) & (off <= OFF_PLANE * np.median(off))
        points = points[kept]
        if len(points) <= NEIGHBOURS:
            break
    distance, index = cKDTree(points).query(points, k=min(NEIGHBOURS + 1, len(points)))
    _, normals = _plane(points, index)
    towards = np.zeros_like(points)
    for centre in centres:
        rows = visible_from(points, centre)
        ray = centre - points[rows]
        towards[rows] += ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    # Seen from both sides through gaps, a point's own vote may be close: neighbours along the surface vote with it.
    own = (normals * towards).sum(-1)
    alike = (normals[index[:, 1:]] * normals[:, None]).sum(-1) ** 3
    side = own
    for _ in range(VOTES):
        side = own + (alike * side[index[:, 1:]]).mean(-1)
    normals *= np.where(side < 0, -1.0, 1.0)[:, None]
    return OrientedPoints(points, normals, float(np.median(distance[:, 1:5].mean(-1))))


def _plane(points: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of every point to the plane of the points index [N, K], and that plane's normal (either sign)."""
    near = points[index]
    middle = near.mean(1)
    spread = near - middle[:, None]
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    normal = axes[:, :, 0]
    return np.abs(((points - middle) * normal).sum(-1)), normal


def visible_from(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Indices of the points that no others hide from `centre`: spherical flip and convex hull (Katz et al. 2007)."""
    ray = points - centre
    length = np.linalg.norm(ray, axis=-1, keepdims=True)
    radius = length.max() * 10**FLIP
    flipped = ray + 2 * (radius - length) * ray / length
    try:
        corners = ConvexHull(np.concatenate([flipped, np.zeros((1, 3))])).vertices
    except QhullError:  # all in one plane with the camera: nothing hides anything
        return np.arange(len(points))
    return np.sort(corners[corners < len(points)])


class PointSurface:
    """The closed surface through oriented points (screened Poisson, Kazhdan and Hoppe 2013) as a signed distance."""

    def __init__(self, cloud: OrientedPoints, fades: bool) -> None:
        """`fades`: further than SUPPORT spacings from every point the surface gives way to what is known otherwise."""
        import open3d as o3d

        self.cloud, self.fades = cloud, fades
        self.tree = cKDTree(cloud.points)
        low, high = cloud.points.min(0), cloud.points.max(0)
        self.middle, self.size = 0.5 * (low + high), float((high - low).max())  # open3d casts rays in float32
        legacy: Any = o3d.geometry.PointCloud()
        legacy.points = o3d.utility.Vector3dVector((cloud.points - self.middle) / self.size)
        legacy.normals = o3d.utility.Vector3dVector(cloud.normals)
        depth = int(np.clip(np.ceil(np.log2(1.1 * self.size / cloud.spacing)), 4, FINEST))
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            # one thread: with more the result changes from run to run
            mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(legacy, depth=depth, n_threads=1)
        self.solid = RayMesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles))

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance [M] (world units, positive inside) at points [M, 3]."""
        out = self.solid.signed_distance((points - self.middle) / self.size) * self.size
        if self.fades:
            nearest, _ = self.tree.query(points)
            out = out + np.maximum(nearest - SUPPORT * self.cloud.spacing, 0)
        return out.astype(np.float32)

    def cut(self, points: np.ndarray, hull: np.ndarray) -> np.ndarray:
        """Signed distance [M] to what lies inside both this surface and the hull of signed distance `hull` [M].

        The hull is exact where the object bulges and smoother than any cloud: it stays where the points lie less than
        DEEPER spacings below it, gives way within as much again, and is cut to the points' surface beyond.
        """
        least = DEEPER * self.cloud.spacing
        deeper = np.maximum(hull - self.signed_distance(points), 0)
        return (hull - deeper * np.clip(deeper / least - 1, 0, 1)).astype(np.float32)
