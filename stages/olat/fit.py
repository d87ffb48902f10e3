"""Many pixels at once, over threads; samples are turned from frame order to pixel order on the way.

Threads of our own, not numba's: the kernels release the interpreter's lock, cameras may be fitted side by side, and a parallel
region would be compiled a second time.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit, types
from numba.extending import overload

from stages.olat.columns import WIDTH
from stages.olat.pixel import fit_pixel
from stages.olat.workspace import Settings, make_room

CHUNK = 16  # pixels: 96 contiguous bytes of a half-float frame, and a chunk's samples stay in the L2 cache
SHARE = 256  # pixels that a thread takes at a time


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


@njit(cache=True, error_model="numpy", nogil=True)
def fit_pixels(first, last, cross, parallel, table, view, points, directions, positions, area, intensity, settings, out, norms):
    """Fit pixels [first, last).

    cross, parallel [N, P, 3]: half-float bits (uint16) or floats; view float64 [P, 3]: to the camera; points [P, 3]: where each
    pixel's surface is (for near lights; [0, 3] means distant lights); directions [3, N], positions float64 [N, 3],
    area, intensity [N]. `out` float64 [P, WIDTH] and `norms` [P, 2] (specular gradient norm, passes) are filled.
    """
    count = cross.shape[0]
    near = points.shape[0] > 0
    room = make_room(count, area)
    x = np.empty((CHUNK, 3, count), area.dtype)
    y = np.empty((CHUNK, 3, count), area.dtype)
    w, energy = directions, intensity
    if near:
        w, energy = np.empty_like(directions), np.empty_like(intensity)
    for start in range(first, last, CHUNK):
        width = min(CHUNK, last - start)
        for k in range(count):
            for p in range(width):
                for c in range(3):
                    x[p, c, k] = value(cross[k, start + p, c], table)
                    y[p, c, k] = value(parallel[k, start + p, c], table)
        for p in range(width):
            at = start + p
            if near:
                _near(points[at], positions, intensity, w, energy)
            norms[at, 0], norms[at, 1] = fit_pixel(x[p], y[p], w, view[at], area, energy, settings, room, out[at])


def fit(cross, parallel, view, rig, settings: Settings, precision: str = "float32", points=None, threads: int | None = None):
    """`fit_pixels` over threads, on samples [N, P, 3] under a `LightTable` with solid angles.

    Returns rows float64 [P, WIDTH] and norms [P, 2]. The result does not depend on the number of threads.
    """
    kind = np.dtype(precision).type
    pixels = cross.shape[1]
    out, norms = np.zeros((pixels, WIDTH)), np.zeros((pixels, 2))
    arguments = (
        np.ascontiguousarray(cross), np.ascontiguousarray(parallel), half_table(),
        np.ascontiguousarray(view, np.float64),
        np.zeros((0, 3)) if points is None else np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(rig.directions.T, kind), np.ascontiguousarray(rig.positions, np.float64),
        np.ascontiguousarray(rig.solid_angle, kind), np.ascontiguousarray(rig.intensity, kind), settings, out, norms,
    )  # fmt: skip
    starts = range(0, max(pixels, 1), SHARE)  # called for no pixels too: that loads the kernels
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        for task in [pool.submit(fit_pixels, start, min(start + SHARE, pixels), *arguments) for start in starts]:
            task.result()
    return out, norms
