"""A ball with a pattern, seen from all around, made by formula."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.asset.bake import Textured, bake
from pipeline.asset.views import PropertyView
from pipeline.geometry.cameras import Camera, camera_from_opengl
from synth.orbit import fibonacci_sphere, look_at

SIZE, DISTANCE = 48, 4.0
FOCAL = 0.42 * SIZE * DISTANCE


def pattern(position: np.ndarray) -> np.ndarray:
    """Albedo [..., 3] of the ball's points [..., 3]: smooth, with no symmetry."""
    x, y, z = np.moveaxis(position, -1, 0)
    return 0.5 + 0.3 * np.stack([np.sin(3 * x), np.sin(2 * y + x), np.sin(3 * z)], -1)


def octahedral_ball(splits: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Vertices on the unit sphere and outward triangles."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    signs = [(i, j, k) for i in (0, 3) for j in (1, 4) for k in (2, 5)]
    corners = [vertices[list(s)] if np.linalg.det(vertices[list(s)]) > 0 else vertices[[s[0], s[2], s[1]]] for s in signs]
    triangles = np.array(corners)
    for _ in range(splits):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = ((p + q) / np.linalg.norm(p + q, axis=1, keepdims=True) for p, q in ((a, b), (b, c), (c, a)))
        triangles = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    unique, index = np.unique(triangles.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    return unique, index.reshape(-1, 3)


def ball_view(direction: np.ndarray) -> PropertyView:
    """The ball from one side: normals, pattern, roughness .3, index 1.5."""
    camera = Camera(SIZE, SIZE, FOCAL, FOCAL, SIZE / 2, SIZE / 2, camera_from_opengl(look_at(DISTANCE * direction)))
    rays = camera.rays()
    along = rays @ camera.centre
    inside = along**2 - (DISTANCE**2 - 1)
    hit = (inside > 0) & (along < 0)
    reach = np.where(hit, -along - np.sqrt(np.maximum(inside, 0)), 0)
    point = camera.centre + rays * reach[..., None]
    values = np.concatenate([point, pattern(point), np.full((*hit.shape, 1), 0.3), np.full((*hit.shape, 1), 1.5)], -1)
    depth = reach * (rays @ camera.world_to_camera[2, :3])
    images = (np.where(hit[..., None], values, 0), hit, depth)
    return PropertyView(camera, *(np.ascontiguousarray(i, np.float32) for i in images))


@pytest.fixture(scope="session")
def ball_views() -> list[PropertyView]:
    """Twelve views."""
    return [ball_view(d) for d in fibonacci_sphere(12)]


@pytest.fixture(scope="session")
def baked(ball_views) -> Textured:
    """The ball's textures, one texel a pixel."""
    vertices, faces = octahedral_ball()
    return bake(vertices, faces, vertices, ball_views, DISTANCE / FOCAL, 256)


@pytest.fixture(scope="session")
def bake_ball() -> Callable[..., Textured]:
    """Function that bakes views onto the ball."""

    def go(views: list[PropertyView], largest: int = 256) -> Textured:
        vertices, faces = octahedral_ball()
        return bake(vertices, faces, vertices, views, DISTANCE / FOCAL, largest)

    return go


@pytest.fixture(scope="session")
def truth() -> Callable[[np.ndarray], np.ndarray]:
    """The pattern."""
    return pattern
