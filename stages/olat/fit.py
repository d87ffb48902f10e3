"""Many pixels at once: chunks of pixels over the threads, samples turned from frame order to pixel order on the way."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange, types
from numba.extending import overload

from stages.olat.pixel import WIDTH, Settings, fit_pixel, make_room

CHUNK = 16  # pixels: 96 contiguous bytes of a half-float frame, and a chunk's samples stay in the L2 cache
TOO_BRIGHT = np.float32(65504.0)  # the largest half float


def half_table() -> np.ndarray:
    """float32 [65536]: the value of every half float by its bits."""
    return np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float32)


def value(sample, table):
    """A stored sample as a number: half floats (uint16 bits) by table, floats as they are."""
    return table[sample] if isinstance(sample, np.uint16) else sample


@overload(value, inline="always")
def _value(sample, table):
    if isinstance(sample, types.Integer):
        return lambda sample, table: table[sample]
    return lambda sample, table: sample


@njit(cache=True, error_model="numpy")
def _near(point, positions, intensity, w, energy):
    """Directions [3, N] and relative irradiance [N] at `point` from lights at `positions` [N, 3] (inverse square)."""
    for k in range(positions.shape[0]):
        x, y, z = positions[k, 0] - point[0], positions[k, 1] - point[1], positions[k, 2] - point[2]
        square = x * x + y * y + z * z
        size = math.sqrt(square)
        w[0, k], w[1, k], w[2, k] = x / size, y / size, z / size
        centre = positions[k, 0] ** 2 + positions[k, 1] ** 2 + positions[k, 2] ** 2
        energy[k] = intensity[k] * centre / square


@njit(cache=True, error_model="numpy", parallel=True, nogil=True)
def fit_pixels(cross, parallel, table, view, points, directions, positions, area, intensity, settings, out, norms):
    """Fit pixels in parallel.

    cross, parallel [N, P, 3]: half-float bits (uint16) or floats; view float64 [P, 3]: to the camera; points [P, 3]: where each
    pixel's surface is (for near lights; [0, 3] means distant lights); directions [3, N], positions float64 [N, 3],
    area, intensity [N]. `out` float64 [P, WIDTH] and `norms` [P, 2] (specular gradient norm, passes) are filled.
    """
    count, pixels = cross.shape[0], cross.shape[1]
    near = points.shape[0] > 0
    for chunk in prange((pixels + CHUNK - 1) // CHUNK):
        first = chunk * CHUNK
        width = min(CHUNK, pixels - first)
        x = np.empty((CHUNK, 3, count), area.dtype)
        y = np.empty((CHUNK, 3, count), area.dtype)
        for k in range(count):
            for p in range(width):
                for c in range(3):
                    x[p, c, k] = value(cross[k, first + p, c], table)
                    y[p, c, k] = value(parallel[k, first + p, c], table)
        room = make_room(count, area)
        w, energy = directions, intensity
        if near:
            w, energy = np.empty_like(directions), np.empty_like(intensity)
        for p in range(width):
            if near:
                _near(points[first + p], positions, intensity, w, energy)
            norm, passes = fit_pixel(x[p], y[p], w, view[first + p], area, energy, settings, room, out[first + p])
            norms[first + p, 0], norms[first + p, 1] = norm, passes


def fit(cross, parallel, view, rig, settings: Settings, precision: str = "float32", points=None):
    """`fit_pixels` on samples [N, P, 3] under a `LightTable` with solid angles. Returns rows float64 [P, WIDTH] and norms [P, 2]."""
    kind = np.dtype(precision).type
    out = np.zeros((cross.shape[1], WIDTH))
    norms = np.zeros((cross.shape[1], 2))
    fit_pixels(
        np.ascontiguousarray(cross), np.ascontiguousarray(parallel), half_table(),
        np.ascontiguousarray(view, np.float64),
        np.zeros((0, 3)) if points is None else np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(rig.directions.T, kind), np.ascontiguousarray(rig.positions, np.float64),
        np.ascontiguousarray(rig.solid_angle, kind), np.ascontiguousarray(rig.intensity, kind), settings, out, norms,
    )  # fmt: skip
    return out, norms
