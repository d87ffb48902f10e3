"""GrabCut of one view alone (Rother et al. 2004, OpenCV's), for when nothing else is known."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import srgb_encode

ROUNDS = 5
BORDER = 0.04
"""Share of the frame along its border that is taken to be background."""


def display(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear [H, W, 3] as 8-bit sRGB, exposed so that the 98th percentile is bright."""
    level = float(np.percentile(image, 98))
    return (srgb_encode(np.maximum(image, 0) / max(level, 1e-12) * 0.8) * 255 + 0.5).astype(np.uint8)


def grabcut_centre(image: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Object mask [H, W] of a linear image whose border shows background."""
    height, width = image.shape[:2]
    trimap = np.full((height, width), cv2.GC_PR_FGD, np.uint8)
    y, x = max(1, int(BORDER * height)), max(1, int(BORDER * width))
    trimap[:y], trimap[-y:], trimap[:, :x], trimap[:, -x:] = (cv2.GC_BGD,) * 4
    return grabcut(image, trimap)


def grabcut(image: NDArray[np.float32], trimap: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Refine a trimap of cv2's four labels; an image without two classes keeps the trimap."""
    labels = trimap.copy()
    object_now = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    if object_now.all() or not object_now.any() or np.ptp(image) == 0:
        return object_now
    cv2.setRNGSeed(0)  # its k-means starts at random
    whole = (0, 0, 0, 0)  # unused with a mask
    cv2.grabCut(display(image), labels, whole, np.zeros((1, 65)), np.zeros((1, 65)), ROUNDS, cv2.GC_INIT_WITH_MASK)
    return (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
