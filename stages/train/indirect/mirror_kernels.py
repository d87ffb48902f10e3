"""Numba kernel over a view's pixels: which of them show the object, and which way they mirror."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

from ..splats.splat_kernels import MATH

_TWO = np.float32(2)


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
