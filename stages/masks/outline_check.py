"""Are given cameras those of these outlines? And if not: which mistake, undone, makes them so.

Wrong focal lengths, a shift or another order of the poses leave a visual hull that nearly fills every mask; the tangent planes
of pairs of views show them (synthetic captures of 96 to 512 pixels: 0.1 px off as they are, 0.5 to 4 px with focal lengths
doubled or halved).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import some
from pipeline.geometry.camera_slips import AS_GOOD, likeliest
from pipeline.geometry.cameras import Camera
from pipeline.geometry.odd_cameras import FEW, odd_cameras
from pipeline.geometry.outline_tangents import hull_points, tangent_errors
from pipeline.geometry.view_groups import two_groups

FEWEST, MOST = 4, 40
"""Views whose outlines say something, and that are held against each other (780 pairs: 15 ms)."""
ROUNDING = 0.25
"""Pixels by which an edge is off on average when it is rounded to pixels: cameras within it fit."""
KEPT = 0.75
"""Of all equations, the better part: a quarter may be of views whose masks are wrong."""
LOG_ODDS = 10.0
"""By which a mistake must explain the outlines better, errors being Laplacian and each view one independent measurement."""
EXPLAINED = 0.01
"""Of the longer side: what is off by more without a mistake is not explained by it."""
LEAST_GAIN = 2.0
"""Factor by which errors must shrink however many views there are: masks may be wrong in a common way."""


def outline_doubt(cameras: Mapping[str, Camera], masks: Mapping[str, NDArray[np.bool_]]) -> str | None:
    """Hold pinhole cameras against the outlines of one still object.

    Args:
        cameras: by view.
        masks: by view, True inside; those that are empty or reach the border say nothing. [H, W] each

    Returns:
        The mistake that explains why they do not fit, in words with figures; None where they fit, where no mistake explains it,
        and where outlines are too few.
    """
    views = sorted(cameras)
    found = {k: hull_points(masks[view]) for k, view in enumerate(views) if view in masks}
    outlines = {k: points for k, points in found.items() if points is not None}
    if len(outlines) < FEWEST:
        return None
    listed = [cameras[view] for view in views]
    chosen = _evenly(list(outlines))
    points = np.stack([outlines[k] for k in chosen])

    def error(tried: Sequence[Camera]) -> float:
        return misfit([tried[k] for k in chosen], points)

    as_given = error(listed)
    if as_given > ROUNDING:
        slip, left = likeliest(listed, error)
        apart, rest = _two_objects([views[k] for k in chosen], [listed[k] for k in chosen], points)
        if apart and rest * AS_GOOD < left:
            slip, left = apart, rest
        enough = left * max(LEAST_GAIN, float(np.exp(LOG_ODDS / len(chosen)))) < as_given
        if enough and left <= EXPLAINED * max(max(camera.width, camera.height) for camera in listed):
            off = f"the cameras do not fit the outlines of the object, which are {as_given:.1f} px off"
            return f"{off}: {slip} (then {left:.1f} px)"
    return _single_views(views, listed, outlines)


def _two_objects(views: Sequence[str], cameras: Sequence[Camera], outlines: NDArray[np.float64]) -> tuple[str | None, float]:
    """Whether the views are of two objects (or of two places of one), in words, and the misfit within each."""
    pairs, errors = tangent_errors(cameras, outlines)
    if not len(pairs):
        return None, float("inf")
    shift = np.abs(errors.sum(1)) / 2  # masks that are too large in some views are off by as much on either side
    groups = two_groups(len(views), pairs, shift <= 2 * ROUNDING)
    if groups.smaller < FEWEST or groups.within < KEPT or groups.across > 1 - KEPT:
        return None, float("inf")
    left = np.sort(np.abs(errors[groups.same(pairs)]).mean(1))
    return groups_said(views, groups.second), float(left[: max(1, int(KEPT * len(left)))].mean())


def groups_said(views: Sequence[str], second: NDArray[np.bool_]) -> str:
    """Words for views of two objects.

    Args:
        views: their names.
        second: True for those of the second group. [V]
    """
    first, other = ([view for view, there in zip(views, second) if there == of] for of in (False, True))
    return (
        f"two groups of views fit each for itself, {len(first)} ({some(first)}) and {len(other)} ({some(other)}): is another "
        "object in one of them, or was the object moved? Keep each in a capture of its own"
    )


def _evenly(numbers: list[int]) -> list[int]:
    return [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, min(len(numbers), MOST)).round().astype(int))]


@dataclass(frozen=True)
class Tangents:
    """Evidence of outlines' hull points [V, N, 2]."""

    points: NDArray[np.float64]

    def __call__(self, cameras: Sequence[Camera], view: int | None = None) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Pairs [E, 2] and errors [E], pixels, of both sides of all pairs, or of those that hold `view`."""
        chosen = None if view is None else np.array([(view, k) for k in range(len(cameras)) if k != view], np.intp)
        pairs, errors = tangent_errors(cameras, self.points, chosen)
        return np.repeat(pairs, 2, 0), np.abs(errors).ravel()


def misfit(cameras: Sequence[Camera], outlines: NDArray[np.float64]) -> float:
    """Compute the mean error of the better part of all pairs' tangents.

    Args:
        cameras: V pinholes.
        outlines: their hull points. [V, N, 2]

    Returns:
        Pixels; infinite where fewer pairs have tangents.
    """
    _, errors = tangent_errors(cameras, outlines)
    count = int(KEPT * len(cameras) * (len(cameras) - 1))  # two equations a pair
    if errors.size < max(count, 1):
        return float("inf")
    return float(np.sort(np.abs(errors), axis=None)[:count].mean())


def _single_views(views: Sequence[str], cameras: Sequence[Camera], outlines: Mapping[int, NDArray]) -> str | None:
    """Views that fit the others only when they are turned; of many, each group is spread over all."""
    numbers = list(outlines)
    groups = -(-len(numbers) // MOST)
    said: dict[str, str] = {}
    for first in range(groups):
        part = numbers[first::groups]
        listed, points = [cameras[k] for k in part], np.stack([outlines[k] for k in part])
        found = odd_cameras(listed, Tangents(points), KEPT, 2 * ROUNDING, 2 * ROUNDING, 2 * (FEWEST - 1))
        said |= {views[part[k]]: words for k, words in found.items()}
    if not said or len(said) > FEW * len(numbers):
        return None
    which = "; ".join(f"{view} ({words})" for view, words in sorted(said.items()))
    return (
        f"a camera does not fit the outlines in the other views: {which}: check its pose, and that picture and mask are of "
        "this view"
    )
