"""Compute the maps that come with the program (`pipeline.environments`): `python -m synth.shipped_maps` writes them.

Skies follow the CIE's standard general sky (ISO 15469 / CIE S 011), the clear one with its sun and a lawn's grey below.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from synth.environments import Map, directions

HEIGHT = 128  # rows: 1.4 degrees each, as fine as a relit lobe of roughness 0.15 is wide
FINER = 4  # samples along a texel's sides
GROUND = 0.2  # reflectance of the earth under a sky
SUN_UP_DEG, SUN_ASIDE_DEG, SUN_RADIUS_DEG = 45.0, 40.0, 1.5  # the disc is spread over two texels: its light counts
SUN_OVER_SKY = 4.5  # horizontal illuminance of sun and of sky on a clear day, the sun half way up (70 and 15 klx)


def towards(elevation_deg: float, azimuth_deg: float) -> NDArray[np.float64]:
    """Unit direction at an elevation, turned from +z towards +x."""
    e, a = np.radians(elevation_deg), np.radians(azimuth_deg)
    return np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])


def box(d: NDArray, elevation_deg: float, azimuth_deg: float, width_deg: float, height_deg: float) -> NDArray[np.float64]:
    """A softbox [H, W, 1] facing the middle: 1 inside its rectangle, dimmer towards its edge as a diffuser is."""
    axis = towards(elevation_deg, azimuth_deg)
    right = np.cross([0.0, 1.0, 0.0], axis)
    right /= np.linalg.norm(right)
    along = d @ axis
    across = np.stack([d @ right, d @ np.cross(axis, right)]) / np.maximum(along, 1e-6)
    half = np.tan(np.radians([width_deg, height_deg]) / 2)[:, None, None]
    inside = (np.abs(across) < half).all(0) & (along > 0)
    return (inside * (1 - 0.35 * ((across / half) ** 2).mean(0)))[..., None]


def disc(d: NDArray, elevation_deg: float, azimuth_deg: float, radius_deg: float) -> NDArray[np.float64]:
    """1 inside a cone about a direction. [H, W, 1]"""
    return (d @ towards(elevation_deg, azimuth_deg) > np.cos(np.radians(radius_deg)))[..., None].astype(float)


def neutral_studio(d: NDArray) -> NDArray:
    """A grey room with four softboxes, without any colour."""
    room = 0.16 + 0.08 * d[..., 1:2]
    key, fill = 7.0 * box(d, 40, 45, 40, 40), 1.6 * box(d, 15, -65, 50, 70)
    rim, top = 5.0 * box(d, 20, 165, 16, 60), 2.5 * box(d, 88, 0, 50, 50)
    return (room + key + fill + rim + top) * np.ones(3)


def key_and_fill(d: NDArray) -> NDArray:
    """One small lamp in a dark room, and a large dim one opposite."""
    return (0.02 + 60.0 * disc(d, 45, 45, 8) + 0.5 * box(d, 10, -70, 70, 70)) * np.ones(3)


def overcast_sky(d: NDArray) -> NDArray:
    """The CIE overcast sky: three times as bright overhead as at the horizon."""
    sky = (1 + 2 * np.maximum(d[..., 1:2], 0)) / 3 * np.array([0.94, 1.0, 1.08])
    return np.where(d[..., 1:2] > 0, sky, GROUND * horizontal(sky, d) / np.pi)


def clear_sky(d: NDArray) -> NDArray:
    """The CIE clear sky of low turbidity (type 12), blue overhead and pale at the horizon, and the sun."""
    sun = towards(SUN_UP_DEG, SUN_ASIDE_DEG)
    up = np.maximum(d[..., 1:2], 1e-3)
    away = np.arccos(np.clip(d @ sun, -1, 1))[..., None]
    gradation = 1 - np.exp(-0.32 / up)
    indicatrix = 1 + 10 * (np.exp(-3 * away) - np.exp(-1.5 * np.pi)) + 0.45 * np.cos(away) ** 2
    pale = (1 - up) ** 3
    colour = pale * np.array([0.90, 0.98, 1.12]) + (1 - pale) * np.array([0.42, 0.75, 1.55])
    sky = np.where(d[..., 1:2] > 0, gradation * indicatrix * colour, 0)
    shine = disc(d, SUN_UP_DEG, SUN_ASIDE_DEG, SUN_RADIUS_DEG) * np.array([1.08, 1.0, 0.88])
    shine *= SUN_OVER_SKY * horizontal(sky, d).mean() / horizontal(shine, d).mean()
    lit = sky + shine
    return np.where(d[..., 1:2] > 0, lit, GROUND * np.array([1.05, 1.0, 0.85]) * horizontal(lit, d) / np.pi)


def solid_angles(height: int) -> NDArray[np.float64]:
    """Of the texels of a map's rows. [height, 1]"""
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    return ((edges[:-1] - edges[1:]) * np.pi / height)[:, None]


def horizontal(light: NDArray, d: NDArray) -> NDArray[np.float64]:
    """Irradiance [3] of a level surface."""
    return np.einsum("ijc,ij->c", light * np.ones(3), np.maximum(d[..., 1], 0) * solid_angles(len(d)))


def brightest_matte(light: NDArray) -> float:
    """Radiance of a white matte surface under the map, turned to where it is brightest (mean of the colours)."""
    d = directions(len(light))
    weighted = (light.mean(-1) * solid_angles(len(light))).ravel()
    normals = directions(16).reshape(-1, 3)
    return float((np.maximum(normals @ d.reshape(-1, 3).T, 0) @ weighted).max() / np.pi)


MAPS: dict[str, Callable[[NDArray], NDArray]] = {
    "neutral_studio": neutral_studio,
    "clear_sky": clear_sky,
    "overcast_sky": overcast_sky,
    "key_and_fill": key_and_fill,
}


def computed(name: str, height: int = HEIGHT) -> Map:
    """A map [height, 2 height, 3], each texel the mean over its area."""
    fine = MAPS[name](directions(FINER * height))
    light = fine.reshape(height, FINER, 2 * height, FINER, 3).mean((1, 3))
    return np.asarray(light / brightest_matte(light), np.float32)


def main() -> None:
    """Write every map to where the program finds it."""
    from pipeline.environments import SHIPPED, shipped_map
    from pipeline.formats.images import write_exr

    for name in SHIPPED:
        path, light = shipped_map(name), computed(name)
        assert path is not None
        write_exr(path, {c: light[..., k] for k, c in enumerate("RGB")}, half=True)
        print(path, f"{path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
