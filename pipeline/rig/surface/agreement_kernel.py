"""The inner loop of the search along rays: how well other cameras' maps agree with a pixel's at every distance (numba)."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel

EMPTY = 0.25  # coverage below which a point is off the object: an outline's own points may have less than half
WHOLE = 0.8  # square length of a normal between four pixels below which they are not of one surface, or not all known


OFF = -1.0  # said in place of a weight where a point is off the object


@kernel(error_model="numpy")
def _judged(x, y, z, own, features, mask, surface, pose, centre, lens, size, scales):
    """(weight, truncated disagreement) of one camera about the point x, y, z; see `disagreements`."""
    cz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
    if cz <= 0:
        return 0.0, 0.0
    u = lens[0] * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / cz + lens[2] - 0.5
    v = lens[1] * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / cz + lens[3] - 0.5
    if not (u >= 0 and v >= 0 and u <= size[0] - 1 and v <= size[1] - 1):
        return 0.0, 0.0
    i, j = min(int(u), size[0] - 2), min(int(v), size[1] - 2)
    a, b = u - i, v - j
    w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    if w00 * mask[j, i] + w01 * mask[j, i + 1] + w10 * mask[j + 1, i] + w11 * mask[j + 1, i + 1] < EMPTY:
        return OFF, 1.0
    ox, oy, oz = centre[0] - x, centre[1] - y, centre[2] - z
    distance = math.sqrt(ox * ox + oy * oy + oz * oz)
    facing = (ox * own[0] + oy * own[1] + oz * own[2]) / distance
    seen = surface[j + (1 if b > 0.5 else 0), i + (1 if a > 0.5 else 0)]
    if facing < scales[2] or (seen > 0 and distance > seen * (1 + scales[3])):
        return 0.0, 0.0
    miss, length = 0.0, 0.0
    for k in range(6):
        f = w00 * features[j, i, k] + w01 * features[j, i + 1, k]
        f += w10 * features[j + 1, i, k] + w11 * features[j + 1, i + 1, k]
        d = f - own[k]
        miss += d * d * (scales[0] if k < 3 else scales[1])
        length += f * f if k < 3 else 0.0
    if length < WHOLE:  # next to pixels without a normal, or across an edge
        return 0.0, 0.0
    return facing, min(miss, 1.0)


@kernel(parallel=True, nogil=True, error_model="numpy")
def disagreements(
    rays,  # [P, 3] float64, unit, world
    base,  # [P] float64, distances
    steps,  # [S] float64, factors on the distances
    own,  # [P, 6] float32, normal and albedo of the pixels
    origin,  # [3]
    features,  # [C, H, W, 6] float32, of the other cameras; normals 0 where unknown
    masks,  # [C, H, W] float32
    surfaces,  # [C, H, W] float32, distances seen by them; 0 where not known
    poses,  # [C, 3, 4] float64, world to camera
    centres,  # [C, 3]
    lenses,  # [C, 4] float64: fx, fy, cx, cy
    sizes,  # [C, 2] int64: width, height
    scales,  # (inverse square tolerance of normals, of albedos; least facing cosine; share of the distance that hides)
    cost,  # [P, S] float32, filled: sum of truncated disagreements times weights
    weight,  # [P, S] float32, filled: sum of weights
):
    """A camera counts by the cosine at which it sees the point; one that it is hidden from, or whose frame ends before it, does
    not. A point off the object in any camera's mask costs the whole weight."""
    for p in prange(rays.shape[0]):
        for s in range(steps.size):
            t = base[p] * steps[s]
            x, y, z = origin[0] + t * rays[p, 0], origin[1] + t * rays[p, 1], origin[2] + t * rays[p, 2]
            total, whole = 0.0, 0.0
            for c in range(poses.shape[0]):
                share, miss = _judged(x, y, z, own[p], features[c], masks[c], surfaces[c], poses[c], centres[c], lenses[c],
                                      sizes[c], scales)  # fmt: skip
                if share < 0:
                    total, whole = 1.0, 1.0
                    break
                total += share * miss
                whole += share
            cost[p, s], weight[p, s] = np.float32(total), np.float32(whole)
