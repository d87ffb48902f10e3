"""An ellipsoid of polarised plastic under a small sky, seen from around: exact normals, no files, no other renderer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.geometry.cameras import Camera
from pipeline.shading import Prefilter, cube_directions, shade
from stages.train.views.source_views import SourceView

AXES = np.array([1.0, 0.7, 0.85])
ALBEDO, ROUGHNESS, IOR = (0.5, 0.25, 0.15), 0.3, 1.5


def sky(resolution: int = 16, sun: float = 20.0) -> torch.Tensor:
    """Radiance [6, R, R, 3]: ground, sky, a soft sun of peak `sun`."""
    d = cube_directions(resolution)
    up = d[..., 1:2]
    light = 0.25 + 0.5 * np.clip(up, 0, 1) * np.array([0.7, 0.9, 1.2]) + 0.2 * np.clip(d[..., :1], 0, 1)
    towards = np.array([0.5, 0.6, 0.62])
    light = light + sun * np.exp(40 * (d @ (towards / np.linalg.norm(towards)) - 1))[..., None]
    return torch.as_tensor(light, dtype=torch.float32)


def look_at(direction: np.ndarray, distance: float, roll: float = 0.0) -> np.ndarray:
    """World-to-camera (OpenCV) of a camera at `distance` along `direction`, looking at the origin."""
    z = -direction / np.linalg.norm(direction)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    out = np.eye(4)
    out[:3, :3] = np.stack([c * x + s * y, c * y - s * x, z])
    out[:3, 3] = -out[:3, :3] @ (direction / np.linalg.norm(direction) * distance)
    return out


def plastic_image(camera: Camera, lit: np.ndarray, normal: np.ndarray, light) -> np.ndarray:
    """Stokes [H, W, 3, 3] of plastic with normals [H * W, 3] at the pixels `lit` [H * W], black elsewhere."""
    rays = camera.rays().reshape(-1, 3)
    x, y = (f.reshape(-1, 3)[lit] for f in camera.stokes_frame())
    tensors = [torch.as_tensor(v, dtype=torch.float32) for v in (normal[lit], -rays[lit], x, y)]
    n = int(lit.sum())
    material = torch.tensor(ALBEDO).expand(n, 3), torch.full((n,), ROUGHNESS), torch.full((n,), IOR)
    stokes = np.zeros((len(rays), 3, 3), np.float32)
    stokes[lit] = shade(*tensors[:2], *material, *tensors[2:], light, mirror="lobe-48").stokes.numpy()
    return stokes.reshape(camera.height, camera.width, 3, 3)


def ball_interval(camera: Camera, middle: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances [H * W] at which a camera's rays enter and leave a ball; infinity and minus infinity where they miss it."""
    rays, towards = camera.rays().reshape(-1, 3), camera.centre - middle
    b = (rays * towards).sum(-1)
    root = b * b - (towards**2).sum() + radius**2
    half = np.sqrt(np.maximum(root, 0))
    return np.where(root > 0, -b - half, np.inf), np.where(root > 0, -b + half, -np.inf)


def ellipsoid_hit(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Which of a camera's rays meet the ellipsoid [H * W], and its unit normals there [H * W, 3]."""
    rays, centre = camera.rays().reshape(-1, 3), camera.centre
    a, b, c = ((rays / AXES) ** 2).sum(-1), (rays * centre / AXES**2).sum(-1), ((centre / AXES) ** 2).sum() - 1
    root = b * b - a * c
    points = centre + rays * ((-b - np.sqrt(np.maximum(root, 0))) / a)[:, None]
    normal = points / AXES**2
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return root > 0, normal


def ellipsoid_view(camera: Camera, light) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(Stokes [H, W, 3, 3], mask [H, W], normals [H, W, 3]) by analytic intersection."""
    hit, normal = ellipsoid_hit(camera)
    shape = (camera.height, camera.width)
    return plastic_image(camera, hit, normal, light), hit.reshape(shape), (normal * hit[:, None]).reshape(*shape, 3)


@pytest.fixture(scope="session")
def make_sources():
    """make_sources(size, count, sun=, roll=) -> sorted SourceViews with full Stokes; every 8th is a test view."""

    def make(size: int = 40, count: int = 16, sun: float = 20.0, roll: float = 0.0) -> list[SourceView]:
        light = Prefilter(16, "beckmann").apply(sky(sun=sun))
        out = []
        for k in range(count):
            angle, height = 2.4 * k, -0.4 + 1.3 * k / count
            direction = np.array([np.cos(angle), height, np.sin(angle)])
            camera = Camera(size, size, 1.7 * size, 1.7 * size, size / 2, size / 2, look_at(direction, 4.5, roll * (k % 5)))
            stokes, mask, _ = ellipsoid_view(camera.resized(2 * size, 2 * size), light)
            stokes, cover = (a.reshape(size, 2, size, 2, *a.shape[2:]).mean((1, 3)) for a in (stokes, mask))
            split = "test" if k % 8 == 0 else "train"
            full = (cover > 0.99).astype(np.float32)  # as the renderers' masks: wholly covered pixels
            out.append(SourceView(f"{k:03d}", split, camera, stokes.astype(np.float32), full, np.ones(full.shape, bool)))
        return out

    return make


def moved(sources: list[SourceView], scale: float, rotation: np.ndarray, shift: np.ndarray) -> list[SourceView]:
    """The same capture in another world: x' = scale R x + shift."""
    out = []
    for s in sources:
        matrix = s.camera.world_to_camera.copy()
        turned = matrix[:3, :3] @ rotation.T
        matrix[:3, 3] = scale * matrix[:3, 3] - turned @ shift
        matrix[:3, :3] = turned
        out.append(replace(s, camera=replace(s.camera, world_to_camera=matrix)))
    return out
