"""Numba kernels for the rays that splats and pixels send out while training: where they begin and where they go."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.frame_kernel import frame_across
from pipeline.kernels.compiling import kernel

from .splat_kernels import MATH

_ONE, _ZERO, _TWO = np.float32(1), np.float32(0), np.float32(2)
_TINY = np.float32(1e-30)  # -log(1 - u) is 0 at u = 0, and its root stays


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def turned_directions(local, normals, turn, out):
    """out [P, K, 3]: directions [K, 3] about z, turned about it by `turn` [P] and carried to the normals [P, 3]."""
    for p in range(len(normals)):
        nx, ny, nz = normals[p, 0], normals[p, 1], normals[p, 2]
        ux, uy, uz, vx, vy, vz = frame_across(nx, ny, nz)
        c, s = np.cos(turn[p]), np.sin(turn[p])
        for k in range(len(local)):
            x = c * local[k, 0] - s * local[k, 1]
            y = s * local[k, 0] + c * local[k, 1]
            z = local[k, 2]
            out[p, k, 0] = x * ux + y * vx + z * nx
            out[p, k, 1] = x * uy + y * vy + z * ny
            out[p, k, 2] = x * uz + y * vz + z * nz


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def lobe_directions(normals, view, roughness, u, angle, out, rise):
    """Rays of P pixels through their reflection lobes: mirrored at Beckmann half vectors.

    normals, view [P, 3]: unit, view towards the camera; roughness [P]: perceptual; u, angle [P, K]: of the half vectors, share
    of the lobe within (below 1) and azimuth. out [P, K, 3]; rise [P, K]: the directions' cosines to the normals.
    """
    for p in range(len(normals)):
        nx, ny, nz = normals[p, 0], normals[p, 1], normals[p, 2]
        wx, wy, wz = view[p, 0], view[p, 1], view[p, 2]
        ux, uy, uz, vx, vy, vz = frame_across(nx, ny, nz)
        square = roughness[p] * roughness[p]
        for k in range(u.shape[1]):
            tan2 = -square * square * np.log(_ONE - u[p, k])
            z = _ONE / np.sqrt(_ONE + tan2)
            sine = np.sqrt(max(tan2, _TINY)) * z
            x, y = sine * np.cos(angle[p, k]), sine * np.sin(angle[p, k])
            hx, hy, hz = x * ux + y * vx + z * nx, x * uy + y * vy + z * ny, x * uz + y * vz + z * nz
            twice = _TWO * (hx * wx + hy * wy + hz * wz)
            rx, ry, rz = twice * hx - wx, twice * hy - wy, twice * hz - wz
            out[p, k, 0], out[p, k, 1], out[p, k, 2] = rx, ry, rz
            rise[p, k] = rx * nx + ry * ny + rz * nz
