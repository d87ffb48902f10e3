"""Numba kernels over a view's pixels and the rays that they mirror: which pixels show the object, and which way they look."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

from ..splats.splat_kernels import MATH

BINS = 8  # a side of the square that directions are sorted into: its 64 cells are the bits of a number
_ONE, _ZERO, _TWO, _HALF_BINS = np.float32(1), np.float32(0), np.float32(2), np.float32(BINS / 2)


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def shown(pixels, alpha, least, depth, normals, towards, centre, forward, rows, points, normal, view, mirrored):
    """List the pixels that show the object; returns how many, K.

    pixels [P] flat indices, alpha [P], depth [H W] times alpha, normals and directions towards the camera [P, 3], centre and
    forward [3] of it. Filled up to K: rows [K] in 0 .. P - 1, points, normal, view, mirrored directions [K, 3].
    """
    count = 0
    for p in range(len(pixels)):
        if not alpha[p] > least:
            continue
        x, y, z = towards[p, 0], towards[p, 1], towards[p, 2]
        along = -(x * forward[0] + y * forward[1] + z * forward[2])  # z per unit length of the viewing ray
        distance = depth[pixels[p]] / (alpha[p] * along)
        twice = _TWO * (x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2])
        rows[count] = p
        for k in range(3):
            points[count, k] = centre[k] - distance * towards[p, k]
            normal[count, k], view[count, k] = normals[p, k], towards[p, k]
            mirrored[count, k] = twice * normals[p, k] - towards[p, k]
        count += 1
    return count


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def _bit(x, y, z):
    """The bit of a direction: its cell of the octahedron unfolded to a square (Meyer et al. 2010)."""
    inverse = _ONE / max(abs(x) + abs(y) + abs(z), np.float32(1e-30))
    u, v = x * inverse, y * inverse
    if z < _ZERO:
        a, b = _ONE - abs(v), _ONE - abs(u)
        u, v = (a if u >= _ZERO else -a), (b if v >= _ZERO else -b)
    i = min(max(int((u + _ONE) * _HALF_BINS), 0), BINS - 1)
    j = min(max(int((v + _ONE) * _HALF_BINS), 0), BINS - 1)
    return np.uint64(1) << np.uint64(BINS * i + j)


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def _cell(points, p, low, scale, shape):
    """Indices of the cell that point p lies in, or the nearest one."""
    i = min(max(int((points[p, 0] - low[0]) * scale), 0), shape[0] - 1)
    j = min(max(int((points[p, 1] - low[1]) * scale), 0), shape[1] - 1)
    k = min(max(int((points[p, 2] - low[2]) * scale), 0), shape[2] - 1)
    return i, j, k


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def mark(points, directions, met, low, scale, cells):
    """Set in cells [X, Y, Z] the bits of the rays that met something: met [V, K], from points [V, 3] along [V, K, 3]."""
    for p in range(len(points)):
        i, j, k = _cell(points, p, low, scale, cells.shape)
        for r in range(met.shape[1]):
            if met[p, r]:
                cells[i, j, k] |= _bit(directions[p, r, 0], directions[p, r, 1], directions[p, r, 2])


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def doubtful(points, normals, directions, lift, low, scale, cells, rows, rays):
    """List the K points [K, 3] whose direction's bit is set where they lie; returns how many, M.

    Filled up to M: rows [K], and rays [K, 6] from there, lifted along the normals, in their directions.
    """
    count = 0
    for p in range(len(points)):
        i, j, k = _cell(points, p, low, scale, cells.shape)
        if cells[i, j, k] & _bit(directions[p, 0], directions[p, 1], directions[p, 2]):
            rows[count] = p
            for c in range(3):
                rays[count, c] = points[p, c] + lift * normals[p, c]
                rays[count, 3 + c] = directions[p, c]
            count += 1
    return count
