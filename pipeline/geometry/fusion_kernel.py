"""The inner loop of depth fusion: one view into every voxel (numba)."""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel


@kernel(parallel=True, nogil=True)
def integrate(
    points,  # [N, 3] float32, world
    distance,  # [N] float32, in truncations; updated
    weight,  # [N] float32; updated
    depth,  # [H, W] float32, along the camera's z, 0 where there is no surface
    normal,  # [H, W, 3] float32, world
    world_to_camera,  # [4, 4] float64
    centre,  # [3] float64
    fx,
    fy,
    cx,
    cy,
    truncation,  # world units
    grazing,  # least cosine that counts
    free_weight,  # of a ray that misses the object
):
    """Running weighted mean of the signed distance of each point to the surface that the view shows.

    Depth is bilinear where the four pixels around belong to one surface, the nearest pixel's at an edge; the distance
    along the ray is foreshortened onto the normal, the plane's distance, which also holds at grazing angles.

    Args:
        points: world. [N, 3]
        distance: in truncations, positive outside; updated. [N]
        weight: so far; updated. [N]
        depth: along the camera's z, 0 where there is no surface, negative where nothing is told. [H, W]
        normal: world. [H, W, 3]
        world_to_camera: rigid. [4, 4]
        centre: of the camera. [3]
        fx, fy, cx, cy: of its pinhole, pixels.
        truncation: world units.
        grazing: least cosine between ray and normal that counts.
        free_weight: of a ray that misses the object.
    """
    height, width = depth.shape
    m = world_to_camera
    for k in prange(len(points)):
        px, py, pz = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
        z = m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3]
        if z <= 0.0:
            continue
        x = fx * (m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3]) / z + cx - 0.5
        y = fy * (m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3]) / z + cy - 0.5
        if not (x >= 0.0 and y >= 0.0 and x <= width - 1.0 and y <= height - 1.0):
            continue
        i, j = min(int(x), width - 2), min(int(y), height - 2)
        u, v = x - i, y - j
        a, b, c, d = depth[j, i], depth[j, i + 1], depth[j + 1, i], depth[j + 1, i + 1]
        if a == 0.0 and b == 0.0 and c == 0.0 and d == 0.0:
            share, value = free_weight, 1.0
        else:
            near_j, near_i = j + (1 if v > 0.5 else 0), i + (1 if u > 0.5 else 0)
            there = depth[near_j, near_i]
            if min(min(a, b), min(c, d)) > 0.0 and max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) < 2 * truncation:
                there = (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v
            if there == 0.0:
                continue
            rx, ry, rz = px - centre[0], py - centre[1], pz - centre[2]
            length = np.sqrt(rx * rx + ry * ry + rz * rz)
            n = normal[near_j, near_i]
            cosine = -(rx * n[0] + ry * n[1] + rz * n[2]) / length
            if cosine < grazing:
                continue
            value = (there - z) * (length / z) * cosine / truncation
            if value < -1.0:
                continue
            share, value = cosine * cosine, min(value, 1.0)
        total = weight[k] + share
        distance[k] += (value - distance[k]) * share / total
        weight[k] = total
