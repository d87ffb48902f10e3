"""The mesh seen by any camera, by ray casting with the baked vertex attributes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.ply import Ply
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rays import RayMesh

from .deferred import Surface

SUPERSAMPLE = 2  # rays across a pixel
ATTRIBUTES = ("nx", "ny", "nz", "albedo_r", "albedo_g", "albedo_b", "roughness", "ior")


def read_baked_mesh(path: Path) -> tuple[NDArray, NDArray, NDArray]:
    """Vertices [V, 3], attributes [V, 8] and faces [F, 3] of a mesh.ply of the mesh stage. Raises UserError."""
    ply = Ply(path)
    return ply.vertices(), ply.vertices(ATTRIBUTES), ply.triangles()


@dataclass(frozen=True)
class MeshPixels:
    """What a camera sees of a mesh: M points of finer pixels, and the corners [M, 3] and weights [M, 3] of their triangles."""

    camera: Camera
    hit: NDArray[np.bool_]
    surface: Surface
    corners: NDArray[np.int64]
    weights: NDArray[np.float32]

    def carried(self, values: NDArray) -> NDArray:
        """Values at the vertices [V, C] at the points [M, C]."""
        return np.einsum("mk,mkc->mc", self.weights, values[self.corners])

    def image(self, stokes: NDArray) -> NDArray[np.float32]:
        """Stokes vectors of the points [M, 3, 3] as an image [H, W, 3, 3] on black, each pixel the mean of its finer ones."""
        fine = np.zeros((len(self.hit), 3, 3), np.float32)
        fine[self.hit] = np.nan_to_num(stokes)
        height, width = self.camera.height, self.camera.width
        return fine.reshape(height, SUPERSAMPLE, width, SUPERSAMPLE, 3, 3).mean((1, 3))


class BakedMesh:
    """The mesh with its vertex attributes, ready for rays."""

    def __init__(self, path: Path) -> None:
        self.vertices, self._attributes, self._faces = read_baked_mesh(path)
        self._rays = RayMesh(self.vertices, self._faces)

    def seen_by(self, camera: Camera) -> MeshPixels:
        """What a camera sees, SUPERSAMPLE x SUPERSAMPLE rays a pixel, row by row of the finer image."""
        fine = camera.resized(camera.width * SUPERSAMPLE, camera.height * SUPERSAMPLE)
        return self._met(camera, fine, np.arange(fine.width * fine.height))

    def seen_at(self, camera: Camera, pixels: NDArray[np.int64], side: int) -> MeshPixels:
        """What some pixels, flat indices [U], of a camera show, side x side rays each, one pixel's after the other's."""
        fine = camera.resized(camera.width * side, camera.height * side)
        row, column = np.divmod(pixels, camera.width)
        down, across = np.divmod(np.arange(side * side), side)
        index = (row[:, None] * side + down) * fine.width + column[:, None] * side + across
        return self._met(camera, fine, index.ravel())

    def _met(self, camera: Camera, fine: Camera, index: NDArray[np.int64]) -> MeshPixels:
        rays = fine.rays().reshape(-1, 3)[index]
        frame_x, frame_y = (f.reshape(-1, 3)[index] for f in fine.stokes_frame())
        found = self._rays.cast(fine.centre, rays)
        hit = found.hit
        corners, weights = self._faces[found.triangle[hit]], found.weights[hit]
        values = np.einsum("mk,mkc->mc", weights, self._attributes[corners])
        normal = values[:, :3] / np.maximum(np.linalg.norm(values[:, :3], axis=1, keepdims=True), np.finfo(np.float32).tiny)
        position = fine.centre + rays[hit] * found.distance[hit, None]
        surface = Surface(position, normal, -rays[hit], values[:, 3:8], frame_x[hit], frame_y[hit])
        return MeshPixels(camera, hit, surface, corners, weights)
