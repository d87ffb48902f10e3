"""A rough, sunny environment, random surface points, a ball and a bowl."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.geometry.occluder import Occluder
from pipeline.shading import latlong


def sky(height: int = 64) -> np.ndarray:
    """Smooth sky and ground of several colours with a window and a small sun of 100 [H, 2H, 3], float64."""
    d = latlong.directions(height, 2 * height)[:, :, 0]
    x, y, z = np.moveaxis(d, -1, 0)[:, :, :, None]
    blue, brown = np.asarray([0.5, 0.8, 1.4]), np.asarray([0.35, 0.3, 0.2])
    out = np.where(y > 0, blue * (0.4 + y), brown * (1 + 0.3 * np.sin(5 * x) * np.cos(4 * z)))
    out = out + 6 * np.exp(-(((x - 0.8) / 0.2) ** 2 + ((y - 0.2) / 0.15) ** 2)) * (z > 0)
    sun = np.asarray([0.3, 0.8, -0.52])
    return out + 100 * (d @ (sun / np.linalg.norm(sun)) > np.cos(np.radians(3)))[..., None]


@pytest.fixture(scope="session")
def environment() -> np.ndarray:
    return sky()


def _points(count: int, dtype: torch.dtype = torch.float32, seed: int = 0) -> list[torch.Tensor]:
    """[normal, view, albedo, roughness, ior, frame_x, frame_y] with a few normals turned away from the
    camera."""
    rng = np.random.default_rng(seed)
    unit = lambda a: a / np.linalg.norm(a, axis=-1, keepdims=True)  # noqa: E731
    normal = unit(rng.normal(size=(count, 3)))
    view = unit(normal + 0.95 * unit(rng.normal(size=(count, 3))))
    view[: count // 50] *= -1
    x = unit(np.cross(-view, [0.0, 1.0, 0.0]))
    parts = (normal, view, rng.uniform(size=(count, 3)), rng.uniform(0.05, 1.05, count),
             rng.uniform(0.98, 2.5, count), x, np.cross(x, -view))  # fmt: skip
    return [torch.as_tensor(p, dtype=dtype) for p in parts]


@pytest.fixture(scope="session")
def points():
    """Factory of random surface points: `points(count, dtype, seed)`."""
    return _points


def part_of_ball(n: int = 24, top: float = np.pi) -> tuple[np.ndarray, np.ndarray]:
    """Unit sphere from the +y pole down to the polar angle `top`, outward triangles."""
    theta, phi = np.meshgrid(np.linspace(0, top, n), np.arange(2 * n) * np.pi / n, indexing="ij")
    v = np.stack((np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)), -1).reshape(-1, 3)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(n - 1), np.arange(2 * n), indexing="ij"))
    a, b = i * 2 * n + j, i * 2 * n + (j + 1) % (2 * n)
    return v, np.concatenate((np.stack((a, a + 2 * n, b), -1), np.stack((b, a + 2 * n, b + 2 * n), -1)))


@pytest.fixture(scope="session")
def ball() -> Occluder:
    v, f = part_of_ball()
    return Occluder(v, f, v)


@pytest.fixture(scope="session")
def bowl() -> Occluder:
    """Inside of a half sphere that opens towards +y."""
    v, f = part_of_ball(40, np.pi / 2)
    v = v * [1, -1, 1]
    return Occluder(v, f, -v)
