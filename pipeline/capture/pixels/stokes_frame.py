"""From a file's Stokes vectors to ours: factor, sign and rotation of the frame, as capture.toml's [stokes] says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import StokesConfig

FROM_SUMS = np.float32(0.5)
"""Radiance of files that hold sums of two crossed exposures: twice the radiance behind an unpolarised lens."""
FROM_SUMS_FACT = "files hold twice the radiance: halved"


def apply_stokes_config(stokes: NDArray[np.float32], config: StokesConfig) -> NDArray[np.float32]:
    """Scale, flip s2, then turn the reference axis: [H, W, 3, 3] in, the same shape out (in place where it can be).

    `rotate_deg` is the angle of the file's x axis from ours, counter-clockwise: an AoLP of a in the file is a + rotate.
    """
    if config.scale != 1.0:
        stokes *= np.float32(config.scale)
    if config.flip_s2:
        stokes[:, :, 2] *= np.float32(-1)
    if config.rotate_deg % 180:
        angle = 2 * np.radians(config.rotate_deg)
        c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
        s1, s2 = stokes[:, :, 1].copy(), stokes[:, :, 2].copy()
        stokes[:, :, 1], stokes[:, :, 2] = c * s1 - s * s2, s * s1 + c * s2
    return stokes
