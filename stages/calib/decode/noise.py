"""Noise of an image from itself: the part that no smooth or straight-edged content explains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LAPLACIAN_GAIN = 6.0
"""Standard deviation of the mask [[1, -2, 1], [-2, 4, -2], [1, -2, 1]] on white noise of unit variance (Immerkær 1996)."""
MAX_ROWS = 256


def estimate_noise(image: NDArray[np.float32]) -> float | None:
    """Standard deviation of white noise in [H, W, 3], radiance units; None where the image is too small or flat to tell.

    Immerkær's second difference, with the median in place of the mean: textures and edges are outliers to it.
    """
    height = image.shape[0]
    if min(image.shape[:2]) < 8:
        return None
    start = max(0, (height - MAX_ROWS) // 2)
    rows = image[start : start + MAX_ROWS].mean(-1, dtype=np.float32)
    second = rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2]
    response = np.abs(second[2:] - 2 * second[1:-1] + second[:-2])
    lit = response[response > 0]
    if lit.size < response.size // 20:
        return None
    median_of_normal, colours = 0.6745, np.sqrt(3.0)  # the mean of three colours has 1/sqrt(3) of one colour's noise
    return float(np.median(lit) / median_of_normal / LAPLACIAN_GAIN * colours)
