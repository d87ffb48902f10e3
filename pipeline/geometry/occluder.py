"""Rays against the object's own mesh: what they hit, and whether anything is occluded at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.normals import UPWARD, vertex_normals
from pipeline.geometry.rays import RayMesh

Float = NDArray[np.float32]

# Rays start this share of the mesh's diagonal off the surface: above float32's rounding of hits (1e-6) and the ripple
# of a mesh fused from depth maps, below the features that cast shadows.
LIFT = 2e-3


@dataclass(frozen=True)
class Hits:
    """Where R rays meet a mesh: blocked [R]; of blocked rays the triangle's vertices [R, 3] and weights [R, 3].

    A ray that meets the back of a triangle first began under the surface: it counts as free.
    """

    blocked: NDArray[np.bool_]
    vertices: NDArray[np.int64]
    weights: Float


class Occluder:
    """A triangle mesh to cast rays at (Embree), whose inner sides hide nothing."""

    def __init__(self, vertices: NDArray, triangles: NDArray, normals: NDArray | None = None) -> None:
        """Build the ray structure.

        Args:
            vertices: positions, world units. [V, 3]
            triangles: vertex numbers, counter-clockwise from outside. [F, 3]
            normals: unit, outward; None: from the faces. [V, 3]
        """
        self.vertices = np.ascontiguousarray(vertices, np.float32)
        self.triangles = np.ascontiguousarray(triangles, np.uint32)
        if normals is None:
            normals = vertex_normals(self.vertices, self.triangles, UPWARD).astype(np.float32)
        self.normals = np.asarray(normals)
        self.lift = LIFT * float(np.linalg.norm(np.ptp(self.vertices, axis=0)))
        self._rays = RayMesh(self.vertices, self.triangles)

    def cast(self, origins: NDArray, directions: NDArray) -> Hits:
        """First hits of rays from origins [R, 3] along directions [R, 3]."""
        found = self._rays.cast(origins, directions)
        blocked = found.hit & ((found.normal * directions).sum(-1) < 0)
        return Hits(blocked, self._corners(np.where(blocked, found.triangle, 0)), found.weights)

    def met(self, rays: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int64], Float]:
        """Which of rays [R, 6] (origins, then directions) are blocked [B], and their triangles' vertices and weights [B, 3]."""
        found = self._rays.cast_packed(rays)
        rows = np.flatnonzero(found.hit)
        rows = rows[np.einsum("rk,rk->r", found.normal[rows], rays[rows, 3:]) < 0]
        hits = found.of(rows)
        return rows, self._corners(hits.triangle), hits.weights

    def blocked(self, origins: NDArray, directions: NDArray) -> NDArray[np.bool_]:
        """Whether rays meet anything [R]: cheaper than `cast`."""
        return self._rays.blocked(origins, directions)

    def hidden(self, origins: NDArray, directions: NDArray, distances: NDArray) -> NDArray[np.bool_]:
        """Whether rays [R, 3] meet an outer side nearer than `distances` [R] along unit directions; as `cast` counts hits."""
        found = self._rays.cast(origins, directions)
        return (found.distance < distances) & ((found.normal * directions).sum(-1) < 0)

    def nearest(self, points: NDArray) -> Hits:
        """The closest surface to points [P, 3], as hits."""
        found = self._rays.closest(points)
        return Hits(np.ones(len(points), bool), self._corners(found.triangle), found.weights)

    def _corners(self, triangle: NDArray[np.int64]) -> NDArray[np.int64]:
        return self.triangles[triangle].astype(np.int64)


def simplified(vertices: NDArray, triangles: NDArray, faces: int = 20_000) -> tuple[NDArray, NDArray]:
    """Reduce a mesh to what shadows need (quadric decimation, by Open3D).

    Args:
        vertices: positions. [V, 3]
        triangles: vertex numbers. [F, 3]
        faces: triangles to keep, about; a mesh of no more comes back as it is.

    Returns:
        Vertices [V', 3] and triangles [F', 3].
    """
    if len(triangles) <= faces:
        return vertices, triangles
    import open3d

    o3d: Any = open3d
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.asarray(vertices, np.float64)),
        o3d.utility.Vector3iVector(np.asarray(triangles, np.int32)),
    )
    mesh = mesh.simplify_quadric_decimation(faces)
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles)


def tangent_frames(normals: NDArray) -> NDArray[np.float64]:
    """Build an orthonormal frame about each normal, without a singular direction.

    Source: Duff et al. 2017, "Building an Orthonormal Basis, Revisited", JCGT 6(1), Listing 3.

    Args:
        normals: unit. [P, 3]

    Returns:
        Rows t, b, n. [P, 3, 3]
    """
    x, y, z = np.moveaxis(np.asarray(normals, np.float64), -1, 0)
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    t = np.stack((1 + sign * x * x * a, sign * b, -sign * x), -1)
    u = np.stack((b, sign + y * y * a, -y), -1)
    return np.stack((t, u, np.stack((x, y, z), -1)), axis=-2)
