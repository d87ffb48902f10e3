"""A rough, sunny environment and random surface points."""

from __future__ import annotations

import numpy as np
import pytest
import torch

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
