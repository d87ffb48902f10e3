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
    blur = np.ones(1)
    for _ in range(PASSES):
        blur = np.convolve(blur, (0.25, 0.5, 0.25))
    slope, reach = np.convolve(blur, (-0.5, 0.0, 0.5)), PASSES + 1
    held = np.pad(np.pad(mask, 1, mode="edge"), reach, mode="symmetric")  # what the frame cuts has no outline there
    rows, columns = np.divmod(pixels, mask.shape[1])
    windows = np.lib.stride_tricks.sliding_window_view(held, (2 * reach + 1,) * 2)[rows + 1, columns + 1].astype(float)
    slopes = np.stack([windows @ np.pad(blur, 1) @ slope, windows @ slope @ np.pad(blur, 1)], -1)
    size = np.hypot(slopes[:, 0], slopes[:, 1])
    down, right = -np.where(size > SLOPE, slopes.T / np.maximum(size, 1e-9), 0.0)
    axes = camera.world_to_camera[:3, :3]  # rows: right, down, forward
    return right[:, None] * axes[0] + down[:, None] * axes[1]
