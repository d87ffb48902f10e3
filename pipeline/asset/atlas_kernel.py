"""Triangles into texels (numba)."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel


@kernel(nogil=True)
def rasterise(
    corners,  # [F, 3, 2] float64, in texels
    width,
    height,
    face,  # [H W] int32, -1 where none; written
    weights,  # [H W, 3] float32; written
):
    """The triangle over each texel's centre, and the weights of its corners there."""
    for f in range(len(corners)):
        ax, ay, bx, by, cx, cy = (
            corners[f, 0, 0], corners[f, 0, 1], corners[f, 1, 0], corners[f, 1, 1], corners[f, 2, 0], corners[f, 2, 1]
        )  # fmt: skip
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        low_x, high_x = max(0, int(np.floor(min(ax, bx, cx)))), min(width - 1, int(np.ceil(max(ax, bx, cx))))
        low_y, high_y = max(0, int(np.floor(min(ay, by, cy)))), min(height - 1, int(np.ceil(max(ay, by, cy))))
        for y in range(low_y, high_y + 1):
            for x in range(low_x, high_x + 1):
                px, py = x + 0.5, y + 0.5
                u = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / area
                v = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / area
                w = 1.0 - u - v
                if u >= 0.0 and v >= 0.0 and w >= 0.0:
                    at = y * width + x
                    face[at] = f
                    weights[at, 0], weights[at, 1], weights[at, 2] = u, v, w
