"""Numba kernel: a frame about a unit vector, in float32. `occluder.tangent_frames` gives another one, of arrays in float64."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

_ONE, _ZERO = np.float32(1), np.float32(0)
_LEAST_LENGTH = np.float32(1e-12)  # of a cross product of two axes that are never along each other: never met


@kernel(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
def frame_across(x, y, z):
    """Make a frame about a unit vector, without a singular direction.

    Args:
        x, y, z: of the vector.

    Returns:
        ux, uy, uz, vx, vy, vz: unit vectors across it and each other, u also across the axis that it lies along least.
    """
    a, b, c = abs(x), abs(y), abs(z)
    if a <= b and a <= c:
        ux, uy, uz = _ZERO, -z, y
    elif b <= c:
        ux, uy, uz = z, _ZERO, -x
    else:
        ux, uy, uz = -y, x, _ZERO
    inverse = _ONE / max(np.sqrt(ux * ux + uy * uy + uz * uz), _LEAST_LENGTH)
    ux, uy, uz = ux * inverse, uy * inverse, uz * inverse
    return ux, uy, uz, y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
