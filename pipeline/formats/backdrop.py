"""Pixels to compare against ground truth: the whole frame on a black background, else the mask.

A binary mask cuts off the rim that the object covers by less than half, whose light is the object's all the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BLACK = 1e-3  # mean radiance away from the object, over the object's: below it there is no background to take away


def grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Grow a mask by one pixel in all eight directions.

    Args:
        mask: True inside. [H, W]

    Returns:
        The mask and every pixel that touches it. [H, W]
    """
    h, w = mask.shape
    padded = np.pad(mask, 1)
    return np.logical_or.reduce([padded[y : y + h, x : x + w] for y in range(3) for x in range(3)])


def object_pixels(image: NDArray, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Choose the pixels of a frame to compare with ground truth.

    On a black backdrop the whole frame counts: the rim outside the mask is the object's own light, as in `PSNR, full frame`.
    The backdrop is black where its mean magnitude is at most `BLACK` of the object's.

    Args:
        image: linear radiance. [H, W, 3]
        mask: True inside the object. [H, W]

    Returns:
        True where to compare: everywhere on a black backdrop, else (and for an empty or full mask) `mask`. [H, W]
    """
    if not mask.any() or mask.all():
        return mask
    away = ~grown(mask)
    black = not away.any() or np.abs(image[away]).mean() <= BLACK * np.abs(image[mask]).mean()
    return np.ones_like(mask) if black else mask
