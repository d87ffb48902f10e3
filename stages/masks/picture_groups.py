"""Do the pictures show two objects, or one in two places? Points match within two groups of views, and not across them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.geometry.epipolar import sampson_errors
from pipeline.geometry.view_groups import two_groups
from stages.masks.picture_matches import Matches

LEAST_POINTS = 12
"""Matches of a pair that tell whether it fits."""
MANY = 3 * LEAST_POINTS
"""Matches of the typical pair that fits, where a pair of views as near without matches tells something too."""
SMALLEST = 4
"""Views of a group."""
WITHIN, ACROSS = 0.75, 0.1
"""Share of the pairs that fit, at least within the groups and at most across them."""
MIXED, NEARER = 0.35, 0.8
"""Share of the views to which one of the other group is the nearest (by more than this factor; those to which one is as near
count half): 1 where they take turns, a half where they are mixed, and 0.25 at most where each group is on a side of its own, as
of a board that is printed on both."""


def picture_groups(cameras: Sequence[Camera], matches: Matches, kept: float, good_px: float) -> NDArray[np.bool_] | None:
    """Find out whether views are of two groups that each fit.

    Args:
        cameras: pinholes, one a picture.
        matches: of the pictures.
        kept: share of a pair's matches that are true at least.
        good_px: mean error of these with which a pair fits.

    Returns:
        True for the views of the second group [V]; None where there are no two groups.
    """
    count = len(cameras)
    number, error = _pairs(cameras, matches, kept)
    fits = (number >= LEAST_POINTS) & (error <= good_px)
    if not fits.any():
        return None
    axes = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    angle = np.arccos(np.clip(axes @ axes.T, -1, 1))
    near = np.triu(angle <= np.percentile(angle[fits], 90), 1)
    typical = float(np.median(number[fits & near])) if (fits & near).any() else 0.0
    judged = near & ((number >= LEAST_POINTS) | (typical >= MANY))
    pairs = np.argwhere(judged).astype(np.intp)
    groups = two_groups(count, pairs, fits[judged])
    apart = groups.smaller >= SMALLEST and groups.within >= WITHIN and groups.across <= ACROSS
    return groups.second if apart and _mixed(angle, groups.second) >= MIXED else None


def _mixed(angle: NDArray[np.float64], second: NDArray[np.bool_]) -> float:
    """How much two groups of views [V] look from the same sides, of the angles between them [V, V]."""
    same = second[:, None] == second
    alone = np.eye(len(second), dtype=bool)
    own, other = (np.where(chosen, angle, np.inf).min(1) for chosen in (same & ~alone, ~same))
    return float(np.mean(np.where(other < NEARER * own, 1.0, np.where(other * NEARER < own, 0.5, 0.0))))


def _pairs(cameras: Sequence[Camera], matches: Matches, kept: float) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """How many matches each pair of views has, and the mean error of the better part of them, pixels. [V, V] each, above the
    diagonal"""
    count = len(cameras)
    number, error = np.zeros((count, count), np.intp), np.full((count, count), np.inf)
    errors = sampson_errors(cameras, matches.pairs, matches.first, matches.second)
    chosen, which = np.unique(matches.pairs, axis=0, return_inverse=True)
    for k, (i, j) in enumerate(chosen):
        own = np.sort(errors[which.reshape(-1) == k])
        number[i, j], error[i, j] = len(own), own[: max(1, int(kept * len(own)))].mean()
    return number, error
