"""Two views of one point: how far a pair of pixels is from what two cameras allow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera

SHORTEST = 1e-9
"""Of a baseline, beside the cameras' mean distance from their middle: below it two centres are one, and anything is allowed."""


def essential_matrices(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """Compute the essential matrix of every pair of cameras, from the first to the second.

    Args:
        cameras: V of them.

    Returns:
        Matrices E with second . E . first = 0 for rays to one point; not a number between cameras of one place. [V, V, 3, 3]
    """
    rotation = np.stack([c.world_to_camera[:3, :3] for c in cameras])
    centre = np.stack([c.centre for c in cameras])
    apart = centre[:, None] - centre[None]
    x, y, z = np.moveaxis(np.einsum("brc,abc->abr", rotation, apart), -1, 0)
    cross = np.moveaxis(np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]), (0, 1), (-2, -1))
    matrices = cross @ (rotation[None] @ rotation.transpose(0, 2, 1)[:, None])
    spread = np.linalg.norm(centre - centre.mean(0), axis=1).mean()
    matrices[np.linalg.norm(apart, axis=-1) <= SHORTEST * spread] = np.nan
    return matrices


def sampson_errors(
    cameras: Sequence[Camera], pairs: NDArray[np.intp], first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute first-order distances of matches from the epipolar geometry (Hartley and Zisserman 2004, eq. 11.9).

    Args:
        cameras: pinholes.
        pairs: the cameras of each match. [M, 2]
        first, second: its pixels in the one and the other. [M, 2]

    Returns:
        Pixels; infinite between cameras of one place. [M]
    """
    to_ray = np.stack([np.linalg.inv(c.intrinsics) for c in cameras])
    matrices = to_ray.transpose(0, 2, 1)[None] @ essential_matrices(cameras) @ to_ray[:, None]
    matrix = matrices[pairs[:, 0], pairs[:, 1]]
    line = matrix[:, :, :2] @ first[:, :, None]
    line = line[..., 0] + matrix[:, :, 2]
    back = second[:, None, :] @ matrix[:, :2]
    back = back[:, 0] + matrix[:, 2]
    length = np.sqrt(line[:, 0] ** 2 + line[:, 1] ** 2 + back[:, 0] ** 2 + back[:, 1] ** 2)
    off = np.abs(second[:, 0] * line[:, 0] + second[:, 1] * line[:, 1] + line[:, 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = off / length
    return np.where(np.isfinite(errors), errors, np.inf)
