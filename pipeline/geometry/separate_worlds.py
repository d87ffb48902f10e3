"""Two cameras whose poses were found apart: each has a world of its own, and one object is in two places."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.axes import MOST_PARALLEL
from pipeline.geometry.cameras import Camera
from pipeline.geometry.viewing_axes import looked_at

ONE_WORLD = "were their cameras found apart? find them together (one COLMAP model of both folders), or give one model for both"
FEWEST = 4
"""Views by the same names, to lay one camera's path on the other's."""
ALIKE_DEG, TILTED_DEG = 5.0, 30.0
"""Between a head's two cameras from view to view; between the ups of two worlds. A turn about the up axis is none: two cameras
beside a turntable differ by it."""
UPRIGHT = 0.5
"""Length of the mean of a camera's up axes: below it, it was rolled, and has no up."""
FIT = 0.1
"""Of their misfit as they are: how much better paths lie on each other once one is turned, scaled and moved."""
UNSEEN = 0.5
"""Share of a camera's views that do not even have in the picture what the other camera looks at."""


def two_worlds(first: Mapping[str, Camera], second: Mapping[str, Camera]) -> str | None:
    """Judge whether two physical cameras whose poses were found apart share one world.

    Args:
        first, second: the cameras' views; views that were taken together have the same name.

    Returns:
        What speaks against it, to follow the cameras' names; None where nothing does.
    """
    common = sorted(set(first) & set(second))
    if len(common) >= FEWEST:
        pair = [first[name] for name in common], [second[name] for name in common]
        if not _is_head(*pair) and _tilted(*pair) and _same_path(*pair):
            return "are on one path, but in two coordinate systems"
    if _meet(first) is None or _meet(second) is None:
        return None
    if all(_unseen(views, looked_at(other.values())) > UNSEEN for views, other in ((first, second), (second, first))):
        return "look at two different places"
    return None


def _is_head(first: list[Camera], second: list[Camera]) -> bool:
    """Whether the second camera stands to the first alike in all views: then they have one world, whatever their paths."""
    turns = np.stack([b.world_to_camera[:3, :3] @ a.world_to_camera[:3, :3].T for a, b in zip(first, second)])
    shifts = np.stack([b.world_to_camera[:3, :3] @ (a.centre - b.centre) for a, b in zip(first, second)])
    u, _, v = np.linalg.svd(turns.mean(0))
    apart = np.degrees(np.arccos(np.clip((np.einsum("nij,ij->n", turns, u @ v) - 1) / 2, -1, 1)))
    off = np.linalg.norm(shifts - np.median(shifts, axis=0), axis=1)
    reach = np.ptp(np.stack([c.centre for c in (*first, *second)]), axis=0).max()
    return bool(np.median(apart) < ALIKE_DEG and np.median(off) < FIT * reach)


def _tilted(first: list[Camera], second: list[Camera]) -> bool:
    """Whether both cameras were held upright, but not in one world."""
    up_a, up_b = (np.mean([c.up for c in cameras], axis=0) for cameras in (first, second))
    lengths = np.linalg.norm(up_a), np.linalg.norm(up_b)
    return bool(min(lengths) > UPRIGHT and up_a @ up_b < np.cos(np.radians(TILTED_DEG)) * lengths[0] * lengths[1])


def _same_path(first: list[Camera], second: list[Camera]) -> bool:
    """Whether the second camera's path is the first one's once it is turned, scaled and moved, and far better so.

    Umeyama's similarity (1991).
    """
    a, b = (np.stack([c.centre for c in cameras]) for cameras in (first, second))
    p, q = a - a.mean(0), b - b.mean(0)
    spread = np.linalg.svd(p, compute_uv=False)
    if not spread[1] > 1e-6 * spread[0]:
        return False  # on a line, which any turn about it keeps
    u, s, v = np.linalg.svd(q.T @ p)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ v))])
    turn, scale = (u * sign) @ v, float((s * sign).sum() / (p * p).sum())
    left = np.sqrt(((q - scale * p @ turn.T) ** 2).sum(1).mean())
    return bool(left < FIT * np.sqrt(((b - a) ** 2).sum(1).mean()))


def _meet(views: Mapping[str, Camera]) -> NDArray[np.float64] | None:
    """Where a camera's axes meet; None where they hardly do."""
    axes = np.stack([c.world_to_camera[2, :3] for c in views.values()])
    total = (np.eye(3) - axes[:, :, None] * axes[:, None, :]).sum(0)
    if len(views) < FEWEST or not np.linalg.cond(total) <= MOST_PARALLEL:
        return None
    seen = looked_at(views.values())
    return seen if _unseen(views, seen) < UNSEEN else None


def _unseen(views: Mapping[str, Camera], point: NDArray[np.float64]) -> float:
    """Share of views that do not have the point in the picture."""
    out = 0
    for camera in views.values():
        (u, v), depth = camera.project(point)
        out += not (depth > 0 and 0 <= u <= camera.width and 0 <= v <= camera.height)
    return out / len(views)
