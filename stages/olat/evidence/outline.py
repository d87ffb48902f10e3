"""Which way is out at the object's outline, in the world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera

PASSES = 6
"""Of the binomial filter 1 2 1 along both axes: a Gaussian of 1.7 pixels, whose slope at a straight outline is 0.23."""
SLOPE = 0.08  # of the blurred mask: what it is 2.5 pixels from a straight outline


def outward(mask: NDArray[np.bool_], camera: Camera, pixels: NDArray[np.intp]) -> NDArray[np.float64]:
    """Unit vectors [P, 3] out of the object at flat indices `pixels`; 0 away from the outline and at the frame's edge."""
    blurred = np.pad(mask, 1, mode="edge").astype(np.float32)  # what the frame cuts has no outline there
    for _ in range(PASSES):
        for axis in (0, 1):
            before, after = (np.take(blurred, _shifted(blurred.shape[axis], step), axis) for step in (-1, 1))
            blurred = 0.25 * (before + after) + 0.5 * blurred
    slope = np.stack([np.gradient(blurred, axis=axis) for axis in (0, 1)], -1)[1:-1, 1:-1].reshape(-1, 2)[pixels].astype(float)
    size = np.hypot(slope[:, 0], slope[:, 1])
    down, right = -np.where(size > SLOPE, slope.T / np.maximum(size, 1e-9), 0.0)
    axes = camera.world_to_camera[:3, :3]  # rows: right, down, forward
    return right[:, None] * axes[0] + down[:, None] * axes[1]


def _shifted(count: int, step: int) -> NDArray[np.intp]:
    return np.clip(np.arange(count) + step, 0, count - 1)
