"""How far the pictures of a stack lie off each other, and laying them on each other where capture.toml asks for it.

A movement is a shift and a turn in the image plane, a Euclidean matrix [2, 3] from pixels of the first picture to those of
the second: the shift by phase correlation, both refined by Evangelidis & Psarakis' ECC (PAMI 2008) on edge strength.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import CaptureConfig
from pipeline.capture.naming.grouping import Group
from pipeline.capture.pixels.brackets import read_exposures

REFINED_AT = 1000
"""Longest side (pixels) of the pictures that ECC sees: a turn shows there as well, in a second."""
MOST_TURN_DEG = 5.0
"""A larger turn between two angles is no slip of a tripod but a wrong fit."""


def largest_shift(group: Group, config: CaptureConfig) -> tuple[float, Path]:
    """(pixels, file) of the picture that lies furthest off the first, at its corners."""
    first: NDArray[np.float32] | None = None
    worst = (0.0, group.paths[0])
    for exposures in group.angles.values():
        edges = edge_strength(read_exposures(exposures, config.radiometry).rgb(exposures[0].path))
        if first is None:
            first = edges
        else:
            worst = max(worst, (_furthest(movement_between(first, edges), edges.shape), exposures[0].path))
    return worst


def _furthest(movement: NDArray[np.float64], shape: tuple[int, ...]) -> float:
    """How far a movement takes the corners of [H, W], pixels."""
    height, width = shape
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], float)
    return float(np.linalg.norm(corners @ movement[:, :2].T + movement[:, 2] - corners, axis=-1).max())


def registered(
    first: NDArray[np.float32], rgb: NDArray[np.float32], invalid: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A picture [H, W, 3] moved onto the one whose edge strength is `first`; what it does not reach is invalid [H, W]."""
    import cv2

    matrix = movement_between(first, edge_strength(rgb))  # where each pixel of the result is taken from
    size = (rgb.shape[1], rgb.shape[0])
    cubic, linear = (f | cv2.WARP_INVERSE_MAP for f in (cv2.INTER_CUBIC, cv2.INTER_LINEAR))
    moved = cv2.warpAffine(rgb, matrix, size, flags=cubic, borderMode=cv2.BORDER_REPLICATE)
    marks = cv2.warpAffine(invalid.astype(np.float32), matrix, size, flags=linear, borderValue=1)
    return np.asarray(moved, np.float32), marks > 0


def edge_strength(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Length of the gradient over brightness [H, W] of [H, W, 3]: alike behind every polariser angle, up to a factor."""
    import cv2

    grey = cv2.GaussianBlur(np.ascontiguousarray(rgb.mean(-1)), (0, 0), 1.0)
    down, across = np.gradient(grey)
    return np.hypot(across, down).astype(np.float32)


def movement_between(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float64]:
    """The movement from edge strength `first` [H, W] to `second`; a shift alone where ECC finds nothing better."""
    import cv2

    x, y = shift_between(first, second)
    shift = np.array([[1, 0, x], [0, 1, y]], np.float64)
    scale = min(1.0, REFINED_AT / max(first.shape))
    small = [cv2.resize(e, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for e in (first, second)]
    offset = np.full(2, (scale - 1) / 2)  # a small pixel's centre is s x + (s - 1) / 2
    start = np.column_stack([np.eye(2), scale * shift[:, 2]]).astype(np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-6)
    found: Any = start.copy()
    refine: Any = cv2.findTransformECC  # its stubs ask for more than it does
    try:
        refine(small[0], small[1], found, cv2.MOTION_EUCLIDEAN, criteria, None, 3)
    except cv2.error:  # it does not converge: little texture, or nothing in common
        return shift
    turn, moved = np.asarray(found[:, :2], float), np.asarray(found[:, 2], float)
    movement = np.column_stack([turn, (turn @ offset + moved - offset) / scale])
    centre = np.array([first.shape[1] - 1, first.shape[0] - 1]) / 2
    astray = float(np.linalg.norm(movement[:, :2] @ centre + movement[:, 2] - centre - shift[:, 2]))
    angle = abs(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    return movement if angle < MOST_TURN_DEG and astray < 3 + 0.02 * max(first.shape) else shift


def shift_between(first: NDArray[np.float32], second: NDArray[np.float32]) -> tuple[float, float]:
    """(x, y) by which `second` [H, W] lies to the right of and below `first`, to a fraction of a pixel (phase correlation)."""
    import cv2

    window = cv2.createHanningWindow((first.shape[1], first.shape[0]), cv2.CV_32F)
    (x, y), _ = cv2.phaseCorrelate(first, second, window)
    return float(x), float(y)
