"""Where cameras look."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pipeline.geometry.cameras import Camera

PARALLEL = 1e6
"""Condition number of the axes' normal equations above which they meet nowhere."""


def nearest_to_axes(centres: NDArray, axes: NDArray) -> NDArray[np.float64]:
    """The point nearest to all viewing axes (least squares); the centres' mean where the axes are parallel."""
    middle = centres.mean(0)  # taken out first: world coordinates may be large
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(0)
    if not np.linalg.cond(total) <= PARALLEL:
        return np.asarray(middle)
    return np.asarray(middle + np.linalg.solve(total, np.einsum("nij,nj->i", across, centres - middle)))


def looked_at(cameras: Iterable[Camera]) -> NDArray[np.float64]:
    """The point [3] that cameras look at (see `nearest_to_axes`)."""
    listed = list(cameras)
    return nearest_to_axes(np.stack([c.centre for c in listed]), np.stack([c.world_to_camera[2, :3] for c in listed]))
