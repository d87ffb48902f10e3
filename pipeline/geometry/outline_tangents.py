"""Do outlines fit cameras? A plane through two camera centres that touches an object in one view touches it in the other.

The tangent planes of each pair of views bound the object's outline from both sides (Cipolla, Astrom and Giblin 1995, Motion
from the frontier of curved surfaces): two equations a pair that need no texture, and hold to a fraction of a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera

DIRECTIONS = 128
"""In which an outline's furthest point is kept: one between two of them is off by 3e-4 of the outline's radius."""
SHORTEST = 1e-9
"""Of a baseline, beside the cameras' mean distance: below it two centres are one."""


def hull_points(mask: NDArray[np.bool_]) -> NDArray[np.float64] | None:
    """Find the points of an outline that touch its convex hull.

    Args:
        mask: True inside. [H, W]

    Returns:
        The furthest pixel centres in DIRECTIONS directions [DIRECTIONS, 2]; None where the mask is empty or reaches the
        picture's border, beyond which the object may go on.
    """
    border = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    rows, columns = np.nonzero(mask)
    if border.any() or not len(rows):
        return None
    ends = np.concatenate([_ends(rows, columns), _ends(columns, rows)[:, ::-1]])
    turn = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return ends[(ends @ np.stack([np.cos(turn), np.sin(turn)])).argmax(0)] + 0.5


def _ends(lines: NDArray, places: NDArray) -> NDArray[np.float64]:
    """The first and the last place on each line, as [N, 2 (place, line)]."""
    low, high = np.full(lines.max() + 1, np.iinfo(np.int64).max), np.full(lines.max() + 1, -1)
    np.minimum.at(low, lines, places)
    np.maximum.at(high, lines, places)
    kept = np.nonzero(high >= 0)[0]
    return np.concatenate([np.stack([low[kept], kept], 1), np.stack([high[kept], kept], 1)]).astype(np.float64)


def tangent_errors(
    cameras: Sequence[Camera], outlines: NDArray[np.float64], pairs: NDArray[np.intp] | None = None
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Compute by how much the tangent planes of one view miss the outline of another.

    Args:
        cameras: pinholes. V of them
        outlines: of `hull_points`. [V, DIRECTIONS, 2]
        pairs: of views to compare; None: all. [P, 2]

    Returns:
        Pairs of views [P, 2], and their errors from both sides, pixels [P, 2]. A pair one of whose centres is seen within
        the other's outline has no tangent planes and is left out.
    """
    if pairs is None:
        pairs = np.array(list(combinations(range(len(cameras)), 2)), np.intp).reshape(-1, 2)
    rays = np.stack([_rays(camera, outline) for camera, outline in zip(cameras, outlines)])
    centres = np.stack([camera.centre for camera in cameras])
    focal = np.sqrt([camera.fx * camera.fy for camera in cameras])
    along = centres[pairs[:, 1]] - centres[pairs[:, 0]]
    length = np.linalg.norm(along, axis=1)
    far = length > SHORTEST * max(float(np.linalg.norm(centres - centres.mean(0), axis=1).mean()), 1e-300)
    pairs, along = pairs[far], along[far] / length[far, None]
    towards = rays.mean(1)[pairs].sum(1)
    first = towards - (towards * along).sum(1)[:, None] * along
    first /= np.maximum(np.linalg.norm(first, axis=1), 1e-300)[:, None]
    spans = [_span(rays[pairs[:, k]], first, np.cross(along, first)) for k in (0, 1)]
    scale = np.sqrt(focal[pairs[:, 0]] * focal[pairs[:, 1]])[:, None]
    errors = (spans[0][0] - spans[1][0]) * np.minimum(spans[0][1], spans[1][1]) * scale
    whole = spans[0][2] & spans[1][2]
    return pairs[whole], errors[whole]


def _rays(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit rays through pixels [N, 2], world [N, 3]."""
    local = np.concatenate([(points - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones((len(points), 1))], 1)
    return (local / np.linalg.norm(local, axis=1, keepdims=True)) @ camera.world_to_camera[:3, :3]


def _span(rays: NDArray, first: NDArray, second: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """The least and greatest angle [P, 2] about a baseline of rays [P, N, 3], their sines to it [P, 2], and whether all lie on
    the side that `first` [P, 3] points to."""
    x, y = np.einsum("pnc,pc->pn", rays, first), np.einsum("pnc,pc->pn", rays, second)
    angle = np.arctan2(y, x)
    ends = np.stack([angle.argmin(1), angle.argmax(1)], 1)
    return np.take_along_axis(angle, ends, 1), np.take_along_axis(np.hypot(x, y), ends, 1), x.min(1) > 0
