"""Latitude-longitude maps to cube maps and back, conserving the integral of radiance.

Convention (docs/conventions.md): y up, row 0 along +y, direction (x, y, z) at u = atan2(x, -z)/2pi (mod 1, from
the left edge), v = acos(y)/pi (from the top): Mitsuba 3's.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pipeline.optics import sphere

from .cube import extend, lookup, texel_of

Float = NDArray[np.float64]

# Gauss nodes in azimuth between two edges, and pieces of azimuth across a texel of the top's rim (2/R rad).
AZIMUTH_NODES = 2
NODES_PER_TEXEL = 6
FITTING_ROUNDS = 6
# Arcs taken at a time: bounds the memory at about 200 MB.
BLOCK = 1_000_000


def directions(height: int, width: int, sub: int = 1, rows: range | None = None) -> Float:
    """Unit directions [rows, W, sub^2, 3] of a regular grid of samples inside every pixel (all rows by default)."""
    rows = range(height) if rows is None else rows
    k = (np.arange(sub) + 0.5) / sub
    theta = (np.asarray(rows)[:, None] + k) * (np.pi / height)
    phi = (np.arange(width)[:, None] + k) * (2 * np.pi / width)
    y, s = np.cos(theta)[:, None, :, None], np.sin(theta)[:, None, :, None]
    phi = phi[None, :, None, :]
    d = np.stack(np.broadcast_arrays(s * np.sin(phi), y, -s * np.cos(phi)), axis=-1)
    return d.reshape(len(rows), width, sub * sub, 3)


@lru_cache(maxsize=4)
def overlap(height: int, width: int, resolution: int) -> csr_matrix:
    """Solid angles shared by cube texels and lat-long pixels [6 R^2, H W] (sr).

    Exact along meridians, which cross rows and texels at known heights, and Gauss quadrature over azimuth between
    the columns' and the side texels' edges; then scaled alternately towards both sets of exact solid angles.
    Columns sum to the pixels' to rounding, so the integral of radiance is conserved; rows sum to the texels' within
    2e-3 (in the corners of top and bottom, 512 x 1024 pixels to 32 texels), so constants stay constant to that.
    """
    edges = np.linspace(-1, 1, resolution + 1)
    sides = (np.arctan(edges)[None, :] + np.arange(4)[:, None] * (np.pi / 2)).ravel() % (2 * np.pi)
    # Corners of top and bottom texels are not followed: a texel there gets several nodes instead.
    pieces = int(np.ceil(NODES_PER_TEXEL * resolution * np.pi / width))
    columns = np.arange(width * pieces + 1) * (2 * np.pi / (width * pieces))
    breaks = np.unique(np.concatenate((columns, sides)))
    middle, half = (breaks[1:] + breaks[:-1]) / 2, (breaks[1:] - breaks[:-1]) / 2
    wide = half > 1e-12  # edges that coincide but for rounding
    middle, half = middle[wide], half[wide]
    node, share = np.polynomial.legendre.leggauss(AZIMUTH_NODES)
    phi = (middle[:, None] + half[:, None] * node).ravel()
    weight = (half[:, None] * share).ravel()
    column = np.minimum((np.repeat(middle, AZIMUTH_NODES) / (2 * np.pi) * width).astype(np.int64), width - 1)

    rows = np.cos(np.arange(height + 1) * (np.pi / height))
    shape = (6 * resolution**2, height * width)
    step = max(1, BLOCK // (height + 6 * resolution))
    total = csr_matrix(shape)
    for k in range(0, len(phi), step):
        p = phi[k : k + step, None]
        y = np.sort(np.concatenate(_crossings(p, edges, rows), axis=1), axis=1)
        centre, length = (y[:, 1:] + y[:, :-1]) / 2, np.diff(y, axis=1)
        p, c, w = (np.broadcast_to(x[k : k + step, None], centre.shape) for x in (phi, column, weight))
        real = length > 0
        centre, length, p, c, w = (x[real] for x in (centre, length, p, c, w))
        s = np.sqrt((1 - centre) * (1 + centre))
        texel = texel_of(np.stack((s * np.sin(p), centre, -s * np.cos(p)), -1), resolution)
        row = np.clip(np.searchsorted(-rows, -centre) - 1, 0, height - 1)
        total = total + csr_matrix((length * w, (texel, row * width + c)), shape=shape)
    shared = total.tocoo()
    value = shared.data
    texel_area = np.tile(sphere.cube_solid_angles(resolution).ravel(), 6)
    pixel_area = np.repeat(sphere.latlong_solid_angles(height, width), width)
    for _ in range(FITTING_ROUNDS):
        value = value * (texel_area / np.bincount(shared.row, value, shape[0]))[shared.row]
        value = value * (pixel_area / np.bincount(shared.col, value, shape[1]))[shared.col]
    return csr_matrix((value, (shared.row, shared.col)), shape=shape)


def _crossings(phi: Float, edges: Float, rows: Float) -> tuple[Float, ...]:
    """Heights y [M, *] at which the meridians phi [M, 1] cross pixel rows, side texels, and top and bottom texels."""
    sine, cosine = np.abs(np.sin(phi)), np.abs(np.cos(phi))
    slope = edges * np.maximum(sine, cosine)
    side = slope / np.hypot(1, slope)
    positive = edges[edges >= 0]
    poles = [a / np.hypot(a, positive) for a in (sine, cosine)]
    return (np.broadcast_to(rows, (len(phi), len(rows))), side, *poles, *(-p for p in poles))


def to_cube(image: NDArray, resolution: int) -> Float:
    """Turn a latitude-longitude map into a cube map, by integration, so that no sun falls between samples.

    Args:
        image: radiance. [H, W, C]
        resolution: R, texels on a face's side.

    Returns:
        Mean radiance of each texel. [6, R, R, C]
    """
    height, width, channels = image.shape
    total = overlap(height, width, resolution) @ np.asarray(image, np.float64).reshape(height * width, channels)
    mean = total.reshape(6, resolution, resolution, channels)
    return mean / sphere.cube_solid_angles(resolution)[None, :, :, None]


def from_cube(cube: NDArray, height: int = 256, width: int = 512) -> Float:
    """Turn a cube map into a latitude-longitude map: bilinear, then scaled to conserve what each texel holds.

    The scaling is local (a factor per texel, spread over its pixels), with one last factor per channel (within a
    few parts in a thousand of 1) for the exact integral.

    Args:
        cube: radiance >= 0. [6, R, R, C]
        height, width: of the map, pixels.

    Returns:
        Radiance. [H, W, C]
    """
    resolution, channels = cube.shape[1], cube.shape[-1]
    w = overlap(height, width, resolution)
    d = torch.as_tensor(directions(height, width).reshape(-1, 3))
    table = extend(torch.as_tensor(np.asarray(cube, np.float64)))
    smooth = lookup(table, d, resolution).numpy()
    texel = np.tile(sphere.cube_solid_angles(resolution).ravel(), 6)[:, None]
    pixel = np.repeat(sphere.latlong_solid_angles(height, width), width)[:, None]
    flat = np.asarray(cube, np.float64).reshape(-1, channels)
    held = (w @ smooth) / texel
    # Texels in the dark keep their pixels: 0/0 says nothing about them.
    ratio = np.divide(flat, held, out=np.ones_like(flat), where=held > 0)
    image = smooth * ((w.T @ ratio) / pixel)
    have, want = (pixel * image).sum(0), (texel * flat).sum(0)
    image *= np.divide(want, have, out=np.ones_like(want), where=have > 0)
    return image.reshape(height, width, channels)
