"""Depth views of a sphere, made by formula."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.cameras import Camera, camera_from_opengl
from stages.mesh.gbuffer import DepthView
from synth.orbit import fibonacci_sphere, look_at


def sphere_view(position: np.ndarray, radius: float, size: int = 64) -> DepthView:
    """A sphere about the origin as a G-buffer."""
    distance = float(np.linalg.norm(position))
    focal = 0.42 * size * distance / radius
    camera = Camera(size, size, focal, focal, size / 2, size / 2, camera_from_opengl(look_at(position)))
    rays = camera.rays()
    along = rays @ camera.centre
    inside = along**2 - (distance**2 - radius**2)
    hit = (inside > 0) & (along < 0)
    reach = np.where(hit, -along - np.sqrt(np.maximum(inside, 0)), 0)
    normal = np.where(hit[..., None], (camera.centre + rays * reach[..., None]) / radius, 0)
    depth = reach * (rays @ camera.world_to_camera[2, :3])
    material = np.where(hit[..., None], [0.6, 0.3, 0.1, 0.4, 1.5], 0)
    return DepthView(camera, *(np.ascontiguousarray(a, np.float32) for a in (depth, normal, material, hit)))


@pytest.fixture(scope="session")
def sphere_views():
    """Function radius -> views all around."""

    def make(radius: float, count: int = 14, size: int = 64) -> list[DepthView]:
        return [sphere_view(5 * radius * d, radius, size) for d in fibonacci_sphere(count)]

    return make
