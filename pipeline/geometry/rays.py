"""Rays and distances against a triangle mesh (Embree through Open3D, in float32)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RayHits:
    """Where R rays meet a mesh first.

    Fields:
        distance: along unit directions, infinite for a miss. [R]
        triangle: its number, of hits. [R]
        uv: weights of the triangle's second and third corner. [R, 2]
        normal: the triangle's, by its winding. [R, 3]
    """

    distance: NDArray[np.float32]
    triangle: NDArray[np.int64]
    uv: NDArray[np.float32]
    normal: NDArray[np.float32]

    def of(self, rows: NDArray[np.int64]) -> RayHits:
        """Those of some rays alone."""
        return RayHits(self.distance[rows], self.triangle[rows], self.uv[rows], self.normal[rows])

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Which rays meet anything [R]."""
        return np.isfinite(self.distance)

    @property
    def weights(self) -> NDArray[np.float32]:
        """Weights [R, 3] of the triangle's corners."""
        return _weights(self.uv)

    @property
    def corner(self) -> NDArray[np.int64]:
        """Which corner [R] (0, 1, 2) of its triangle a hit is nearest to, by weight."""
        return np.concatenate([1 - self.uv.sum(-1, keepdims=True), self.uv], -1).argmax(-1)


@dataclass(frozen=True)
class Closest:
    """The points of a mesh closest to P points: position [P, 3], triangle [P], and weights [P, 3] of its corners."""

    position: NDArray[np.float32]
    triangle: NDArray[np.int64]
    weights: NDArray[np.float32]


class RayMesh:
    """A triangle mesh to cast rays at. Positions and directions are taken as float32."""

    def __init__(self, vertices: NDArray, triangles: NDArray) -> None:
        """Build the ray structure.

        Args:
            vertices: positions, world units. [V, 3]
            triangles: vertex numbers, counter-clockwise from outside. [F, 3]
        """
        import open3d

        o3d: Any = open3d
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._single(vertices), self._tensor(np.ascontiguousarray(triangles, np.uint32)))

    def cast(self, origins: NDArray, directions: NDArray) -> RayHits:
        """First hits of rays from origins along directions, [..., 3] each (broadcast); the hits keep the rays' shape."""
        return self.cast_packed(np.concatenate(np.broadcast_arrays(origins, directions), axis=-1))

    def cast_packed(self, rays: NDArray) -> RayHits:
        """`cast` of rays [..., 6]: origins, then directions."""
        found = self._scene.cast_rays(self._single(rays))
        return RayHits(
            found["t_hit"].numpy(),
            found["primitive_ids"].numpy().astype(np.int64),
            found["primitive_uvs"].numpy(),
            found["primitive_normals"].numpy(),
        )

    def distance(self, origins: NDArray, directions: NDArray) -> NDArray[np.float32]:
        """Distance to the first hit of rays [..., 3], infinite for a miss."""
        return self._scene.cast_rays(self._rays(origins, directions))["t_hit"].numpy()

    def blocked(self, origins: NDArray, directions: NDArray) -> NDArray[np.bool_]:
        """Whether rays [..., 3] meet anything: cheaper than `cast`."""
        return self._scene.test_occlusions(self._rays(origins, directions)).numpy()

    def blocked_packed(self, rays: NDArray) -> NDArray[np.bool_]:
        """`blocked` of rays [..., 6]: origins, then directions."""
        return self._scene.test_occlusions(self._single(rays)).numpy()

    def crossings(self, origins: NDArray, directions: NDArray) -> NDArray[np.int32]:
        """How often rays [..., 3] cross the mesh."""
        return self._scene.count_intersections(self._rays(origins, directions)).numpy()

    def every_hit(self, origins: NDArray, directions: NDArray) -> tuple[NDArray, NDArray, NDArray[np.float32]]:
        """Every hit of rays [R, 3], not the first alone [K]: ray, triangle (int64), distance in lengths of its direction."""
        found = self._scene.list_intersections(self._rays(origins, directions))
        ray, triangle = (found[name].numpy().astype(np.int64) for name in ("ray_ids", "primitive_ids"))
        return ray, triangle, found["t_hit"].numpy()

    def closest(self, points: NDArray) -> Closest:
        """The mesh's points closest to points [P, 3]."""
        found = self._scene.compute_closest_points(self._single(points))
        weights = _weights(found["primitive_uvs"].numpy())
        return Closest(found["points"].numpy(), found["primitive_ids"].numpy().astype(np.int64), weights)

    def inside(self, points: NDArray) -> NDArray[np.bool_]:
        """Whether points [..., 3] lie inside the (closed) mesh."""
        return self._scene.compute_occupancy(self._single(points)).numpy() > 0

    def signed_distance(self, points: NDArray) -> NDArray[np.float32]:
        """Distance of points [..., 3] to the (closed) mesh, positive inside."""
        return -self._scene.compute_signed_distance(self._single(points)).numpy()

    def _single(self, values: NDArray) -> Any:
        return self._tensor(np.ascontiguousarray(values, np.float32))

    def _rays(self, origins: NDArray, directions: NDArray) -> Any:
        return self._single(np.concatenate(np.broadcast_arrays(origins, directions), axis=-1))


def _weights(uv: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights [..., 3] of a triangle's corners from the coordinates [..., 2] of its second and third."""
    u, v = np.moveaxis(uv, -1, 0)
    return np.stack((1 - u - v, u, v), -1)
