"""Light-stage pixels with known truth, in plain float64 numpy: independent of the kernels that they test and time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.light_table import LightTable
from pipeline.rig.solid_angles import fibonacci_sphere, solid_angles

Float = NDArray[np.float64]


VIEW = (0.2, 0.1, 1.0)
"""Towards the camera, not normalised."""


@dataclass
class Pixels:
    """Samples of P light-stage pixels under N lights, and what they were made from.

    Fields:
        rig: the lights.
        cross, parallel: radiance behind crossed and parallel polarisers. [N, P, 3]
        view: unit, to the camera. [P, 3]
        normal: unit. [P, 3]
        tangent: unit, direction of the larger width. [P, 3]
        sigma: the lobe's widths. [P, 2]
        albedo: diffuse, linear RGB. [P, 3]
        specular: albedo of the lobe. [P]
    """

    rig: LightTable
    cross: Float
    parallel: Float
    view: Float
    normal: Float
    tangent: Float
    sigma: Float
    albedo: Float
    specular: Float


def rig_of(lights: int = 346) -> LightTable:
    """A rig of near-uniform distant lights."""
    directions = fibonacci_sphere(lights)
    return LightTable(directions, 100 * directions, np.ones(lights), solid_angles(directions))


def unit(v: Float) -> Float:
    """Unit vectors."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def ward(h: Float, n: Float, t: Float, sigma: Float, no: Float) -> Float:
    """Ward-Duer's radiance lobe with its cosine, per unit irradiance."""
    b = np.cross(n, t)
    x, y, z = (np.sum(h * v, -1) for v in (t, b, n))
    q = (x / sigma[..., 0]) ** 2 + (y / sigma[..., 1]) ** 2
    return np.exp(-2 * q / (1 + z)) / (4 * np.pi * sigma[..., 0] * sigma[..., 1] * no)


def beckmann(h: Float, n: Float, t: Float, sigma: Float, no: Float, i: Float, o: Float) -> Float:
    """Anisotropic Beckmann lobe D G / (4 n·o), Smith's G by the exact erf form."""
    from scipy.special import erf

    b = np.cross(n, t)
    x, y, z = (np.sum(h * v, -1) for v in (t, b, n))
    d = np.exp(-((x / sigma[..., 0]) ** 2 + (y / sigma[..., 1]) ** 2) / z**2) / (np.pi * sigma[..., 0] * sigma[..., 1] * z**4)

    def g1(v: Float) -> Float:
        slope = np.hypot(np.sum(v * t, -1) * sigma[..., 0], np.sum(v * b, -1) * sigma[..., 1])
        a = np.maximum(np.sum(v * n, -1) / np.maximum(slope, 1e-12), 1e-6)  # behind the surface nothing is lit anyway
        return 2 / (1 + erf(a) + np.exp(-a * a) / (a * np.sqrt(np.pi)))

    return d * g1(i) * g1(o) / (4 * no)


def ggx(h: Float, n: Float, t: Float, sigma: Float, no: Float, i: Float, o: Float) -> Float:
    """Anisotropic GGX (Trowbridge-Reitz) lobe D G / (4 n·o), Smith's separable G (Heitz 2014)."""
    b = np.cross(n, t)
    x, y, z = (np.sum(h * v, -1) for v in (t, b, n))
    squares = (x / sigma[..., 0]) ** 2 + (y / sigma[..., 1]) ** 2 + z**2
    d = 1 / (np.pi * sigma[..., 0] * sigma[..., 1] * squares**2)

    def g1(v: Float) -> Float:
        slope = np.hypot(np.sum(v * t, -1) * sigma[..., 0], np.sum(v * b, -1) * sigma[..., 1])
        return 2 / (1 + np.sqrt(1 + (slope / np.maximum(np.sum(v * n, -1), 1e-6)) ** 2))

    return d * g1(i) * g1(o) / (4 * no)


def make(
    count: int,
    *,
    rig: LightTable | None = None,
    seed: int = 0,
    lobe: str = "ward",
    sigma: tuple[float, float] | None = None,
    noise: float = 0.0,
    clip: float = np.inf,
    tilt_deg: float = 55.0,
    shadow: float = 0.0,
    views: float = 0.05,
) -> Pixels:
    """`count` pixels of random normals up to `tilt_deg` from the view, albedos and widths (or the given ones).

    noise: standard deviation of a stored sample; clip: its largest value; shadow: each pixel loses the lights within this
    angle (rad) of a direction about 50 degrees off its normal; lobe: "ward", "beckmann" or "ggx"; views: spread of the view
    directions (rad) about `VIEW`.
    Irradiance pi a light, specular factor 2.
    """
    rng = np.random.default_rng(seed)
    rig = rig or rig_of()
    view = unit(np.array(VIEW) + views * rng.normal(size=(count, 3)))
    side = unit(np.cross(view, rng.normal(size=(count, 3))))
    angle = np.radians(tilt_deg) * np.sqrt(rng.uniform(size=(count, 1)))
    normal = unit(np.cos(angle) * view + np.sin(angle) * side)
    tangent = unit(np.cross(normal, rng.normal(size=(count, 3))))
    widths = np.sort(rng.uniform(0.15, 0.4, (count, 2)))[:, ::-1] if sigma is None else np.tile(sigma, (count, 1))
    albedo, specular = rng.uniform(0.1, 0.9, (count, 3)), rng.uniform(0.1, 0.6, count)
    i = rig.directions[:, None]
    h = unit(i + view)
    cosine = np.sum(i * normal, -1)
    no = np.sum(normal * view, -1)
    if lobe == "ward":
        g = ward(h, normal, tangent, widths, no)
    else:
        g = {"beckmann": beckmann, "ggx": ggx}[lobe](h, normal, tangent, widths, no, np.broadcast_to(i, h.shape), view)
    lit = cosine > 0
    if shadow > 0:
        across = unit(np.cross(normal, rng.normal(size=(count, 3))))
        centre = np.cos(0.9) * normal + np.sin(0.9) * across
        lit &= np.sum(i * centre, -1) < np.cos(shadow)
    diffuse = (np.maximum(cosine, 0) * lit)[..., None] * albedo * rig.intensity[:, None, None]
    shine = (specular * g * lit * np.pi * rig.intensity[:, None])[..., None]
    cross = 0.5 * diffuse
    parallel = 0.5 * diffuse + 0.5 * shine
    cross = np.minimum(cross + noise * rng.normal(size=cross.shape), clip)
    parallel = np.minimum(parallel + noise * rng.normal(size=parallel.shape), clip)
    return Pixels(rig, cross, parallel, view, normal, tangent, widths, albedo, specular)


def angle_deg(a: Float, b: Float) -> Float:
    """Angle between vectors, degrees (well conditioned near 0)."""
    a, b = unit(np.asarray(a, float)), unit(np.asarray(b, float))
    return np.degrees(2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))
