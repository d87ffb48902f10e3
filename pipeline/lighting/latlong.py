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

# Rounds of fitting the overlaps to both sets of solid angles: leaves a relative error below 1e-6.
FITTING_ROUNDS = 12
# Samples taken at a time: bounds the memory at about 200 MB.
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


def pixel_coordinates(d: Float) -> tuple[Float, Float]:
    """(u, v) in [0, 1) x [0, 1] of unit directions [..., 3]."""
    u = np.arctan2(d[..., 0], -d[..., 2]) / (2 * np.pi) % 1.0
    return u, np.arccos(np.clip(d[..., 1], -1, 1)) / np.pi


@lru_cache(maxsize=4)
def overlap(height: int, width: int, resolution: int) -> csr_matrix:
    """Solid angles shared by cube texels and lat-long pixels [6 R^2, H W] (sr).

    Sampled, then scaled alternately until rows sum to the texels' and columns to the pixels' exact solid angles:
    constants stay constant and the integral of radiance is conserved.
    """
    # At least 4 samples across a texel of mean size (the smallest is 0.72 of it across), so that none goes empty.
    sub = int(np.clip(np.ceil(16 * resolution / min(2 * height, width)), 2, 16))
    area = sphere.latlong_solid_angles(height, width)
    shape = (6 * resolution**2, height * width)
    step = max(1, BLOCK // (width * sub * sub))
    parts = []
    for start in range(0, height, step):
        rows = range(start, min(height, start + step))
        texel = texel_of(directions(height, width, sub, rows), resolution)
        pixel = (np.asarray(rows)[:, None] * width + np.arange(width))[..., None]
        weight = np.broadcast_to((area[rows] / sub**2)[:, None, None], texel.shape)
        where = (texel.ravel(), np.broadcast_to(pixel, texel.shape).ravel())
        parts.append(csr_matrix((weight.ravel(), where), shape=shape).tocoo())
    row, col, value = (np.concatenate([getattr(p, k) for p in parts]) for k in ("row", "col", "data"))
    row_target = np.tile(sphere.cube_solid_angles(resolution).ravel(), 6)
    col_target = np.repeat(area, width)
    for _ in range(FITTING_ROUNDS):
        value = value * (row_target / np.bincount(row, value, shape[0]))[row]
        value = value * (col_target / np.bincount(col, value, shape[1]))[col]
    return csr_matrix((value, (row, col)), shape=shape)


def to_cube(image: NDArray, resolution: int) -> Float:
    """Texel means [6, R, R, C] of a lat-long map [H, W, C]: integrated, so that no sun falls between samples."""
    height, width, channels = image.shape
    total = overlap(height, width, resolution) @ np.asarray(image, np.float64).reshape(height * width, channels)
    mean = total.reshape(6, resolution, resolution, channels)
    return mean / sphere.cube_solid_angles(resolution)[None, :, :, None]


def from_cube(cube: NDArray, height: int = 256, width: int = 512) -> Float:
    """Lat-long map [H, W, C] of a cube [6, R, R, C] >= 0: bilinear, then scaled to conserve what each texel holds.

    The scaling is local (a factor per texel, spread over its pixels), with one last factor per channel (within a
    few parts in a thousand of 1) for the exact integral.
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
