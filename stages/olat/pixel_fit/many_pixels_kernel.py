"""The kernel that fits many pixels; samples are turned from frame order to pixel order on the way. Importing it loads numba."""

from __future__ import annotations

import math

import numpy as np
from numba import carray, types
from numba.extending import overload

from pipeline.kernels.compiling import kernel
from pipeline.kernels.native import machine_code
from pipeline.kernels.scratch import folded
from stages.olat.pixel_fit.fit_options import CHUNK, WORKSPACE_PER_LIGHT, FitOptions
from stages.olat.pixel_fit.one_pixel import fit_pixel
from stages.olat.pixel_fit.result_layout import WIDTH
from stages.olat.pixel_fit.workspace import make_workspace

COUNT = len(FitOptions._fields)


def value(sample, table):
    """A stored sample as a number: half floats (uint16 bits) by table, floats as they are."""
    return table[sample] if isinstance(sample, np.uint16) else sample


@overload(value, inline="always")
def _value(sample, table):
    if isinstance(sample, types.Integer):
        return lambda sample, table: table[sample]
    return lambda sample, table: sample


@kernel(error_model="numpy")
def _near(point, positions, intensity, w, energy):
    """Directions [3, N] and relative irradiance [N] at `point` from lights at `positions` [N, 3] (inverse square)."""
    for k in range(positions.shape[0]):
        x, y, z = positions[k, 0] - point[0], positions[k, 1] - point[1], positions[k, 2] - point[2]
        square = x * x + y * y + z * z
        size = math.sqrt(square)
        w[0, k], w[1, k], w[2, k] = x / size, y / size, z / size
        centre = positions[k, 0] ** 2 + positions[k, 1] ** 2 + positions[k, 2] ** 2
        energy[k] = intensity[k] * centre / square


@kernel(error_model="numpy")
def _settings(v):
    """Options from their numbers in order."""
    return FitOptions(
        int(v[0]), int(v[1]), int(v[2]), int(v[3]), v[4], v[5], v[6], v[7], v[8], v[9], v[10],
        v[11] != 0, int(v[12]), v[13] != 0, v[14] != 0, v[15] != 0, v[16] != 0, int(v[17]), v[18], int(v[19]),
    )  # fmt: skip


def fit_pixels(
    first, last, count, pixels, near, cross, parallel, table, view, points, directions, positions, area, intensity, gains,
    settings, workspace, front, out, norms,
):  # fmt: skip
    """Fit pixels [first, last) of `pixels` under `count` lights, all arrays by their addresses.

    cross, parallel [N, P, 3]: half-float bits (uint16) or floats; table float32 [65536]; view float64 [P, 3]: to the camera;
    points [P, 3]: where each pixel's surface is, read where the lights are `near`; directions [3, N], positions float64 [N, 3],
    area, intensity [N], gains [3, N]; settings float64: their numbers; workspace [WORKSPACE_PER_LIGHT N], front int64 [N].
    `out` float64 [P, WIDTH] and `norms` [P, 2] (specular gradient norm, passes) are filled.
    """
    samples = (carray(cross, (count, pixels, 3)), carray(parallel, (count, pixels, 3)))
    values, toward, surface = carray(table, 65536), carray(view, (pixels, 3)), carray(points, (pixels, 3))
    w, energy, areas = carray(directions, (3, count)), carray(intensity, count), carray(area, count)
    white = carray(gains, (3, count))
    chosen = _settings(carray(settings, COUNT))
    rows, ends = carray(out, (pixels, WIDTH)), carray(norms, (pixels, 2))
    workspace = carray(workspace, WORKSPACE_PER_LIGHT * count)
    half = 3 * CHUNK * count
    x, y = folded(workspace, 3 * CHUNK, count), folded(workspace[half:], 3 * CHUNK, count)
    rest = workspace[2 * half :]
    if near:
        w, energy = folded(rest, 3, count), rest[3 * count : 4 * count]
    work = make_workspace(count, rest[4 * count :], carray(front, count))
    for start in range(first, last, CHUNK):
        width = min(CHUNK, last - start)
        for k in range(count):
            for p in range(width):
                for c in range(3):
                    x[3 * p + c, k] = value(samples[0][k, start + p, c], values)
                    y[3 * p + c, k] = value(samples[1][k, start + p, c], values)
        for p in range(width):
            at = start + p
            if near:
                _near(surface[at], carray(positions, (count, 3)), carray(intensity, count), w, energy)
            ends[at, 0], ends[at, 1] = fit_pixel(
                x[3 * p : 3 * p + 3], y[3 * p : 3 * p + 3], w, toward[at], areas, energy, white, chosen, work, rows[at]
            )  # fmt: skip


def build(sample: str, precision: str) -> tuple[str, bytes]:
    """Machine code of `fit_pixels` for samples "uint16", "float32" or "float64" and the arithmetic's precision."""
    stored, real, wide = (types.CPointer(getattr(types, name)) for name in (sample, precision, "float64"))
    table, front = types.CPointer(types.float32), types.CPointer(types.int64)
    pointers = (stored, stored, table, wide, wide, real, wide, real, real, real, wide, real, front, wide, wide)
    return machine_code(fit_pixels, (*[types.int64] * 5, *pointers))
