"""Does detail stay in its place from picture to picture, however light falls on it? Texture and outlines do as lights move."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

SIDE, REACH = 16, 6
"""Pixels of a piece, and by how many it is looked for in another picture."""
SMOOTH = 4.0
"""Pixels of the blur whose ratio to the picture is detail: shading is smoother."""
SHOWN = 0.05
"""Spread of the logarithm of a piece below which it has no detail."""
FOUND, IN_PLACE_PX = 0.5, 1
"""Correlation with which a piece is found, and pixels by which it may be off."""
FEWEST = 8
"""Pieces that tell something."""
FLOOR = 0.02
"""Of the bright light: what is darker is noise."""


def still_detail(pictures: NDArray[np.float64]) -> float | None:
    """Compute the share of the pieces with detail in two pictures that are found at their own place in the other.

    Args:
        pictures: linear, grey, of one size. [n, H, W]

    Returns:
        The share over all pairs of pictures; None where hardly a piece has detail.
    """
    import cv2

    floor = FLOOR * np.percentile(pictures, 99)
    logs = [np.log(np.maximum(picture, 0) + max(floor, 1e-12)).astype(np.float32) for picture in pictures]
    details = [log - cv2.GaussianBlur(log, (0, 0), SMOOTH) for log in logs]
    height, width = pictures.shape[1:]
    corners = [(y, x) for y in range(REACH, height - SIDE - REACH + 1, SIDE // 2)
               for x in range(REACH, width - SIDE - REACH + 1, SIDE // 2)]  # fmt: skip
    pieces = found = 0
    for first, second in combinations(details, 2):
        for y, x in corners:
            piece = first[y : y + SIDE, x : x + SIDE]
            if min(piece.std(), second[y : y + SIDE, x : x + SIDE].std()) < SHOWN:
                continue
            around = second[y - REACH : y + SIDE + REACH, x - REACH : x + SIDE + REACH]
            likeness = cv2.matchTemplate(around, piece, cv2.TM_CCOEFF_NORMED)
            off = np.abs(np.unravel_index(int(likeness.argmax()), likeness.shape) - np.array(REACH)).max()
            pieces += 1
            found += bool(likeness.max() > FOUND and off <= IN_PLACE_PX)
    return found / pieces if pieces >= FEWEST else None
