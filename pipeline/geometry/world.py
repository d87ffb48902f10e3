"""The world's axes: a capture's up axis against the y-up frame of environment maps and of training."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Y_UP_FROM: dict[str, NDArray[np.float64]] = {
    "y": np.eye(3),
    "-y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "x": np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]]),
    "-x": np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 1]]),
}
"""Rotation [3, 3] from a capture's world, by its up axis, to the y-up frame: z up takes (x, y, z) to (x, z, -y)."""
UP_AXES = tuple(Y_UP_FROM)
