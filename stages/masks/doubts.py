"""What finished masks and their cameras say together: a segmentation that failed, a one-sided capture."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.axes import nearest_to_lines
from pipeline.geometry.cameras import Camera
from stages.masks.background import Fixation, fixation

MOST = 0.5  # share of the views from which a fault is the capture's, not theirs
CUT = 0.25  # share of the frame's border inside a mask from which the object grows out of the picture
LARGEST = 0.6  # share of a mask in its largest part, below which it is fragments
WHOLE = 0.9  # share of the frame from which a segmentation has taken the scene for the object
ONE_SIDED_DEG = 30.0
"""From the mean direction of the cameras to the furthest: a ring of them 60 degrees above the object is as far from its axis,
steps before a facade, or a forward-facing set, are less."""
FEWEST_AROUND = 8  # views, what training needs: below it nothing is promised


def segmentation_faults(masks: Sequence[NDArray[np.bool_]]) -> list[str]:
    """What is wrong with most of some segmented masks, in words with numbers; empty where nothing is."""
    if not masks:
        return []
    shown = [m for m in masks if m.any()]
    counts = {
        "show nothing": len(masks) - len(shown),
        "take the whole frame": sum(float(m.mean()) > WHOLE for m in shown),
        "grow out of the picture": sum(_cut(m) > CUT for m in shown),
        "are fragments": sum(_largest(m) < LARGEST for m in shown),
    }
    return [f"{count} of {len(masks)} {fault}" for fault, count in counts.items() if count > MOST * len(masks)]


def _cut(mask: NDArray[np.bool_]) -> float:
    return float(np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]]).mean())


def _largest(mask: NDArray[np.bool_]) -> float:
    """Share of the largest part; parts that touch at a corner are one."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    return float(stats[1:, cv2.CC_STAT_AREA].max() / mask.sum())


def looking_away(cameras: Sequence[Camera]) -> str | None:
    """That most cameras have the point behind them where their axes meet, in words; None where they do not."""
    axes = np.stack([c.world_to_camera[2, :3] for c in cameras])
    meeting = nearest_to_lines(np.stack([c.centre for c in cameras]), axes)
    if meeting is None:
        return None
    behind = sum(float(c.project(meeting)[1]) < 0 for c in cameras)
    if behind <= MOST * len(cameras):
        return None
    return (
        f"{behind} of {len(cameras)} cameras look away from the point where their axes meet (are their y and z axes negated, "
        "as OpenCV's are for OpenGL's, or is the matrix from world to camera?)"
    )


def inverted(masks: Sequence[NDArray[np.bool_]]) -> int:
    """How many of some given masks are white all around and black in the middle: the background's, not the object's."""
    return sum(_cut(m) == 1 and not m.all() and _largest(~m) > LARGEST for m in masks)


def one_sided(cameras: Sequence[Camera]) -> str | None:
    """How one-sided the cameras look, in words; None where they go around the object, or are too few to tell."""
    if len(cameras) < FEWEST_AROUND:
        return None
    ball: Fixation | None = fixation(list(cameras))
    if ball is None:
        away = looking_away(cameras)
        return away or "the cameras look in parallel and meet at no object"
    direction = np.stack([c.centre - ball.centre for c in cameras])
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    mean = direction.mean(0) / max(float(np.linalg.norm(direction.mean(0))), 1e-12)
    widest = float(np.degrees(np.arccos(np.clip(direction @ mean, -1, 1)).max()))
    return f"all cameras look from one side, within {widest:.0f} degrees" if widest < ONE_SIDED_DEG else None
