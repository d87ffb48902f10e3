"""A small object in front of a distant, busy background, seen all around: views with known masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from pipeline.geometry.cameras import Camera

PARTS = [((0.0, 0.0, 0.0), 0.55), ((0.0, 0.6, 0.1), 0.3), ((0.5, -0.1, 0.0), 0.25), ((-0.2, -0.55, 0.3), 0.28)]


@dataclass
class Views:
    images: list[np.ndarray]
    masks: list[np.ndarray]
    cameras: list[Camera]
    plates: list[np.ndarray]


def look_at(position: np.ndarray, roll: float, size: int) -> Camera:
    z = -position / np.linalg.norm(position)
    x = np.cross(z, [0, 1, 0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    turn = np.array([[np.cos(roll), np.sin(roll), 0], [-np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3] = turn @ np.stack([x, y, z])
    pose[:3, 3] = -pose[:3, :3] @ position
    return Camera(size, size, 1.6 * size, 1.6 * size, size / 2, size / 2, pose)


def render(camera: Camera, waves: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(image, mask, empty scene) of spheres, shaded, before a background of random waves over directions."""
    rays = camera.rays()
    depth = np.full(rays.shape[:2], np.inf)
    normal = np.zeros_like(rays)
    for centre, radius in PARTS:
        offset = camera.centre - np.array(centre)
        b = (rays * offset).sum(-1)
        inside = b * b - (offset @ offset - radius**2)
        t = np.where(inside > 0, -b - np.sqrt(np.maximum(inside, 0)), np.inf)
        near = t < depth
        depth = np.where(near, t, depth)
        point = camera.centre + rays * np.where(np.isfinite(t), t, 0)[..., None] - centre
        normal = np.where(near[..., None], point / radius, normal)
    sky = sum(a * np.sin(rays @ k + p) for a, k, p in waves)
    background = np.exp(sky[..., None] * [0.9, 0.8, 1.0]) * [0.10, 0.12, 0.07]
    light = 0.35 + 0.65 * np.clip(normal @ np.array([0.4, 0.8, 0.45]), 0, 1)
    mask = np.isfinite(depth)
    return np.where(mask[..., None], light[..., None] * [0.28, 0.22, 0.06], background), mask, background


@pytest.fixture(scope="session")
def views() -> Views:
    rng = np.random.default_rng(3)
    waves = [(0.35, rng.normal(0, 9, 3), rng.uniform(0, 6)) for _ in range(10)]
    cameras, out = [], []
    for i in range(14):
        azimuth, elevation = 2.4 * i, np.radians(-15 + 60 * ((i * 0.618) % 1))
        position = 4.0 * np.array([np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)])
        cameras.append(look_at(position, rng.uniform(-0.5, 0.5), 96))
        out.append(render(cameras[-1], waves))
    noisy = [np.clip(image + rng.normal(0, 2e-3, image.shape), 0, 2).astype(np.float32) for image, _, _ in out]
    plates = [np.clip(b + rng.normal(0, 2e-3, b.shape), 0, 2).astype(np.float32) for _, _, b in out]
    return Views(noisy, [m for _, m, _ in out], cameras, plates)
