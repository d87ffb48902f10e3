"""Quadrature and directions on the sphere: product Gauss rules, a cosine-weighted spiral, solid angles of cube-map texels and
latitude-longitude pixels (numpy, float64)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def sphere_rule(n: int) -> tuple[Float, Float]:
    """Make a quadrature rule on the sphere, exact to degree 2n-1: Gauss-Legendre in y, uniform in azimuth.

    Args:
        n: cosines; 2n azimuths.

    Returns:
        Unit directions [2n^2, 3], and weights in sr with sum 4 pi [2n^2].
    """
    y, w = np.polynomial.legendre.leggauss(n)
    phi = (np.arange(2 * n) + 0.5) * np.pi / n
    s = np.sqrt(1 - y * y)
    d = np.stack((s[:, None] * np.cos(phi), np.broadcast_to(y[:, None], (n, 2 * n)), s[:, None] * np.sin(phi)), axis=-1)
    return d.reshape(-1, 3), np.repeat(w * np.pi / n, 2 * n)


def hemisphere_rule(n: int, m: int) -> tuple[Float, Float]:
    """Make a quadrature rule on the hemisphere about +z: Gauss-Legendre in the cosine, uniform in azimuth.

    Args:
        n: cosines.
        m: azimuths.

    Returns:
        Unit directions [n m, 3], and weights in sr with sum 2 pi [n m].
    """
    x, w = np.polynomial.legendre.leggauss(n)
    z, w = (x + 1) / 2, w / 2
    phi = (np.arange(m) + 0.5) * 2 * np.pi / m
    s = np.sqrt(1 - z * z)
    d = np.stack((s[:, None] * np.cos(phi), s[:, None] * np.sin(phi), np.broadcast_to(z[:, None], (n, m))), axis=-1)
    return d.reshape(-1, 3), np.repeat(w * 2 * np.pi / m, m)


def cosine_directions(count: int) -> Float:
    """Spread directions about +z, as dense as their cosine: each stands for pi / count of the projected solid angle.

    Args:
        count: how many.

    Returns:
        Unit vectors, the Fibonacci spiral of the unit disc lifted to the hemisphere. [count, 3]

    Source: Malley's method (Pharr, Jakob, Humphreys, Physically Based Rendering, 13.6.3).
    """
    sine2 = (np.arange(count) + 0.5) / count
    phi = (np.arange(count) + 0.5) * np.pi * (3 - np.sqrt(5.0))
    sine = np.sqrt(sine2)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.sqrt(1 - sine2)], -1)


def _corner_area(x: Float, y: Float) -> Float:
    """Solid angle between the centre of a cube face (at distance 1) and its point (x, y)."""
    return np.arctan2(x * y, np.sqrt(x * x + y * y + 1))


def cube_solid_angles(resolution: int) -> Float:
    """Compute the exact solid angles of a cube face's texels.

    Args:
        resolution: R, texels on a side.

    Returns:
        sr; six faces sum to 4 pi. [R, R]
    """
    edge = np.linspace(-1, 1, resolution + 1)
    a = _corner_area(edge[None, :], edge[:, None])
    return a[1:, 1:] - a[1:, :-1] - a[:-1, 1:] + a[:-1, :-1]


def latlong_solid_angles(height: int, width: int) -> Float:
    """Compute the exact solid angles of a latitude-longitude map's pixels.

    Args:
        height, width: of the map, pixels.

    Returns:
        sr of one pixel of each row; all pixels sum to 4 pi. [H]
    """
    v = np.arange(height + 1) * np.pi / height
    # cos a - cos b = 2 sin((a+b)/2) sin((b-a)/2): no cancellation in the polar rows
    return 2 * np.sin((v[:-1] + v[1:]) / 2) * np.sin(np.pi / height / 2) * 2 * np.pi / width
