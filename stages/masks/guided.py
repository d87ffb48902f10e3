"""A coarse map brought to full size along the image's edges (He et al., "Guided image filtering", 2013)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def guided_upsample(coarse: NDArray, image: NDArray[np.float32], eps: float = 1e-4) -> NDArray[np.float64]:
    """`coarse` [h, w] at the size of `image` [H, W, 3] (linear), following its edges.

    Locally the map is an affine function of the image's encoded luminance; `eps` is the variance below which a window
    counts as flat (1 % of the encoded range, squared).
    """
    height, width = image.shape[:2]
    guide = np.sqrt(np.clip(image.mean(-1) / max(float(np.percentile(image, 98)), 1e-12), 0, 1)).astype(np.float32)
    rough = cv2.resize(np.clip(coarse, -6, 6).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    radius = max(1, round(max(height / coarse.shape[0], 1.0)))
    size = (2 * radius + 1, 2 * radius + 1)

    def mean(x: NDArray) -> NDArray:
        return cv2.blur(x, size)

    m, r = mean(guide), mean(rough)
    slope = (mean(guide * rough) - m * r) / (mean(guide * guide) - m * m + eps)
    return (mean(slope) * guide + mean(r - slope * m)).astype(np.float64)
