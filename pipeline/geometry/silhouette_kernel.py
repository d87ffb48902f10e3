"""How far inside a silhouette many points lie, in one pass over them (numba). Twin in numpy: `silhouette_hull.occupancy` with
overruled views."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel


@kernel(nogil=True, error_model="numpy")
def judge(points, matrix, lens, distance, worst, judges):
    """Lower worst [M] (float32) to what a picture says of points [M, 3], and count in judges [M] where it says anything.

    matrix [4, 4]: world to camera; lens: fx, fy, cx, cy; distance [H, W]: pixels inside the silhouette, looked up bilinearly
    and worth a pixel's width at the point's depth.
    """
    height, width = distance.shape
    focal = 0.5 * (lens[0] + lens[1])
    for p in range(len(points)):
        x, y, w = points[p, 0], points[p, 1], points[p, 2]
        z = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * w + matrix[2, 3]
        if not z > 0:
            continue
        u = lens[0] * (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * w + matrix[0, 3]) / z + lens[2]
        v = lens[1] * (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * w + matrix[1, 3]) / z + lens[3]
        if not (0 <= u <= width and 0 <= v <= height):
            continue
        u, v = min(max(u - 0.5, 0.0), width - 1.0), min(max(v - 0.5, 0.0), height - 1.0)
        i, j = min(int(v), max(height - 2, 0)), min(int(u), max(width - 2, 0))
        s, t = u - j, v - i
        right, below = min(j + 1, width - 1), min(i + 1, height - 1)
        top = distance[i, j] + (distance[i, right] - distance[i, j]) * s
        bottom = distance[below, j] + (distance[below, right] - distance[below, j]) * s
        worst[p] = min(worst[p], np.float32((top + (bottom - top) * t) * (z / focal)))
        judges[p] += 1
