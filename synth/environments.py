"""Procedural HDR environments, latitude-longitude, linear RGB, y up (row 0 looks along +y; Mitsuba 3's convention)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Map = NDArray[np.float32]


def directions(height: int) -> NDArray[np.float64]:
    """Compute the directions of a latitude-longitude map's texels: u = atan2(x, -z) / 2 pi, v = acos(y) / pi.

    Args:
        height: texels; the width is twice that.

    Returns:
        Unit, world, y up. [height, 2 height, 3]
    """
    width = 2 * height
    azimuth = (np.arange(width) + 0.5) * (2 * np.pi / width)
    polar = (np.arange(height) + 0.5) * (np.pi / height)
    p, a = np.meshgrid(polar, azimuth, indexing="ij")
    return np.stack([np.sin(p) * np.sin(a), np.cos(p), -np.sin(p) * np.cos(a)], -1)


def _lamp(d: NDArray, towards: tuple[float, float, float], cosine: float, sharpness: float) -> NDArray:
    """Soft disc [H, W, 1] around `towards`: 1 inside the cone of that cosine, falling off over 1/sharpness."""
    axis = np.asarray(towards) / np.linalg.norm(towards)
    return 1 / (1 + np.exp(-sharpness * (d @ axis - cosine)))[..., None]


def meadow(height: int = 128) -> Map:
    """Blue sky, soft afternoon sun, white cloud bank, green-brown ground."""
    d = directions(height)
    up = d[..., 1:2]
    sky = np.array([0.22, 0.42, 0.85]) * (0.35 + 0.45 * np.clip(up, 0, 1))
    sky = sky + np.array([0.55, 0.50, 0.42]) * np.exp(-7 * np.abs(up))
    ground = np.array([0.12, 0.11, 0.05]) * (1 + 0.5 * np.sin(9 * d[..., :1]) * np.sin(7 * d[..., 2:]))
    edge = 1 / (1 + np.exp(-40 * up))
    out = ground * (1 - edge) + sky * edge
    out = out + _lamp(d, (-0.8, 0.25, 0.5), 0.86, 30) * np.array([0.85, 0.85, 0.9])
    out = out + _lamp(d, (0.6, 0.62, 0.5), 0.975, 300) * np.array([22.0, 18.5, 13.5])
    return np.ascontiguousarray(out, dtype=np.float32)


def studio(height: int = 128) -> Map:
    """Dark room with a warm key, a cool fill strip and a small white kicker."""
    d = directions(height)
    out = np.array([0.06, 0.06, 0.07]) + 0.05 * np.clip(d[..., 1:2], 0, 1)
    out = out + _lamp(d, (0.7, 0.7, -0.5), 0.90, 60) * np.array([5.2, 4.1, 2.9])
    strip = _lamp(d, (-1.0, 0.1, -0.2), 0.86, 50) * (1 / (1 + np.exp(60 * (np.abs(d[..., 2:3] + 0.2) - 0.18))))
    out = out + strip * np.array([1.3, 2.2, 3.6])
    out = out + _lamp(d, (0.1, 0.3, 1.0), 0.98, 200) * np.array([7.0, 7.0, 7.0])
    return np.ascontiguousarray(out, dtype=np.float32)


ENVIRONMENTS: dict[str, Callable[[int], Map]] = {"meadow": meadow, "studio": studio}
