"""How far the pictures of a stack lie off each other, and laying them on each other where capture.toml asks for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.brackets import read_exposures
from pipeline.capture.config import CaptureConfig
from pipeline.capture.grouping import Group


def largest_shift(group: Group, config: CaptureConfig) -> tuple[float, Path]:
    """(pixels, file) of the picture that lies furthest off the first."""
    first: NDArray[np.float32] | None = None
    worst = (0.0, group.paths[0])
    for exposures in group.angles.values():
        edges = edge_strength(read_exposures(exposures, config.radiometry).rgb(exposures[0].path))
        if first is None:
            first = edges
        else:
            worst = max(worst, (float(np.hypot(*shift_between(first, edges))), exposures[0].path))
    return worst


def laid_on(
    first: NDArray[np.float32], rgb: NDArray[np.float32], spoilt: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A picture [H, W, 3] shifted onto the one whose edge strength is `first`; what it does not reach is spoilt [H, W]."""
    import cv2

    x, y = shift_between(first, edge_strength(rgb))
    matrix = np.array([[1, 0, x], [0, 1, y]], np.float64)  # where each pixel of the result is taken from
    size = (rgb.shape[1], rgb.shape[0])
    cubic, linear = (f | cv2.WARP_INVERSE_MAP for f in (cv2.INTER_CUBIC, cv2.INTER_LINEAR))
    moved = cv2.warpAffine(rgb, matrix, size, flags=cubic, borderMode=cv2.BORDER_REPLICATE)
    marks = cv2.warpAffine(spoilt.astype(np.float32), matrix, size, flags=linear, borderValue=1)
    return np.asarray(moved, np.float32), marks > 0


def edge_strength(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Length of the gradient over brightness [H, W] of [H, W, 3]: alike behind every polariser angle, up to a factor."""
    import cv2

    grey = cv2.GaussianBlur(np.ascontiguousarray(rgb.mean(-1)), (0, 0), 1.0)
    down, across = np.gradient(grey)
    return np.hypot(across, down).astype(np.float32)


def shift_between(first: NDArray[np.float32], second: NDArray[np.float32]) -> tuple[float, float]:
    """(x, y) by which `second` [H, W] lies to the right of and below `first`, to a fraction of a pixel (phase correlation)."""
    import cv2

    window = cv2.createHanningWindow((first.shape[1], first.shape[0]), cv2.CV_32F)
    (x, y), _ = cv2.phaseCorrelate(first, second, window)
    return float(x), float(y)
