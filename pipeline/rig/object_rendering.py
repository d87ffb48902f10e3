"""A light stage's object, its fused maps on its mesh, from any camera under distant lights: shadows by rays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.ply import Ply
from pipeline.geometry.cameras import Camera
from pipeline.geometry.occluder import Occluder
from pipeline.geometry.rays import RayMesh
from pipeline.rig.lobe_names import LOBES
from pipeline.rig.map_rendering import render_pixels

ATTRIBUTES = (
    "nx", "ny", "nz", "albedo_r", "albedo_g", "albedo_b", "specular", "sigma_x", "sigma_y", "tangent_x", "tangent_y",
    "tangent_z",
)  # fmt: skip
LOBE = "lobe "
"""How the comment begins that names the lobe of `sigma_x` and `sigma_y` in the mesh's header."""
PART = 4000  # pixels shaded together: their visibility of all lights is held
TANGENT = 0.5  # length of an interpolated tangent below which the corners' directions do not agree


class RigObject:
    """The mesh that the mesh stage makes of a light stage, ready to be rendered."""

    def __init__(self, path: Path) -> None:
        """Raises UserError where it is no such mesh."""
        ply = Ply(path)
        self.vertices, self.faces = ply.vertices(), ply.triangles()
        self.attributes = ply.vertices(ATTRIBUTES)
        named = [line[len(LOBE) :] for line in comments_of(path) if line.startswith(LOBE)]
        if not named or named[0] not in LOBES:
            raise UserError(path, "its header names no lobe", "run the mesh stage again")
        self.lobe = LOBES[named[0]]
        self._rays = RayMesh(self.vertices, self.faces)
        self._occluder = Occluder(self.vertices, self.faces)

    def render(
        self, camera: Camera, directions: NDArray, light: NDArray, spacing: float = 0.0, subsamples: int = 1
    ) -> NDArray[np.float32]:
        """Linear RGB [H, W, 3], black beside the object: lights from directions [M, 3] (unit, world) of irradiance [M, 3].

        spacing (rad): angle that each light stands for, as `relighting.render_maps` takes it; subsamples: rays across a pixel.
        """
        fine = camera.resized(camera.width * subsamples, camera.height * subsamples)
        rays = fine.rays().reshape(-1, 3)
        found = self._rays.cast(fine.centre, rays)
        hit = np.flatnonzero(found.hit)
        image = np.zeros((len(rays), 3), np.float32)
        lit = light.max(1) > 0
        towards, power = np.ascontiguousarray(directions[lit], float), np.ascontiguousarray(light[lit], float)
        for start in range(0, len(hit), PART):
            at = hit[start : start + PART]
            weights, corners = found.weights[at].astype(float), self.faces[found.triangle[at]]
            values = np.einsum("pk,pkc->pc", weights, self.attributes[corners])
            place = fine.centre + rays[at] * found.distance[at, None]
            image[at] = self._shaded(place, -rays[at], values, found.normal[at], towards, power, spacing)
        blocks = image.reshape(camera.height, subsamples, camera.width, subsamples, 3)
        return blocks.mean((1, 3))

    def _shaded(
        self, place: NDArray, view: NDArray, values: NDArray, facet: NDArray, towards: NDArray, power: NDArray, spacing: float
    ) -> NDArray[np.float64]:
        normal = values[:, :3] / np.maximum(np.linalg.norm(values[:, :3], axis=1, keepdims=True), 1e-9)
        tangent = values[:, 9:12]
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
        tangent = np.where(length > TANGENT, tangent / np.maximum(length, 1e-9), 0.0)
        visible = normal @ towards.T > 0
        pixel, which = np.nonzero(visible)
        origins = (place + self._occluder.lift * normal)[pixel]
        visible[pixel, which] = ~self._occluder.blocked(origins, towards[which])
        rows = render_pixels(
            self.lobe, np.ascontiguousarray(view, float), normal, normal, tangent, np.ascontiguousarray(values[:, 7:9]),
            np.ascontiguousarray(values[:, 6]), towards, power, 0.5 * spacing, visible,
        )  # fmt: skip
        return values[:, 3:6] * rows[:, 0] / np.pi + rows[:, 1]


def comments_of(path: Path) -> list[str]:
    """The comments in a PLY file's header."""
    head = path.read_bytes().split(b"end_header", 1)[0].decode("ascii", "replace").splitlines()
    return [line[len("comment ") :] for line in head if line.startswith("comment ")]
