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
from scipy.optimize import minimize

from pipeline.geometry.camera_slips import likeliest, turned
from pipeline.geometry.cameras import Camera
from pipeline.geometry.outline_tangents import hull_points, tangent_errors

FEWEST, MOST = 4, 40
"""Views whose outlines say something, and that are held against each other (780 pairs: 15 ms)."""
ROUNDING = 0.25
"""Pixels by which an edge is off on average when it is rounded to pixels: cameras within it fit."""
KEPT = 0.75
"""Of all equations, the better part: a quarter may be of views whose masks are wrong."""
LOG_ODDS = 10.0
"""By which a mistake must explain the outlines better, errors being Laplacian and each view one independent measurement."""
LEAST_GAIN = 2.0
"""Factor by which errors must shrink however many views there are: masks may be wrong in a common way."""
STANDS_OUT = 5.0
"""Times the typical view's error from which one view is not like the others."""
LEAST_TURN_DEG = 0.5
"""Of one camera: less is what poses differ by."""
FEW = 0.25
"""Share of the views up to which they are at fault one by one."""


@dataclass(frozen=True)
class OutlineDoubt:
    """What is wrong, in words with figures; `views` are those at fault, none: all."""

    said: str
    views: tuple[str, ...] = ()


def outline_doubt(cameras: Mapping[str, Camera], masks: Mapping[str, NDArray[np.bool_]]) -> OutlineDoubt | None:
    """Hold pinhole cameras against the outlines of one still object.

    Args:
        cameras: by view.
        masks: by view, True inside; those that are empty or reach the border say nothing. [H, W] each

    Returns:
        The mistake that explains why they do not fit; None where they fit, where no mistake explains it, and where outlines are
        too few.
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
        if left * max(LEAST_GAIN, float(np.exp(LOG_ODDS / len(chosen)))) < as_given:
            off = f"the cameras do not fit the outlines of the object, which are {as_given:.1f} px off"
            return OutlineDoubt(f"{off}: {slip} (then {left:.1f} px)")
    return _single_views(views, listed, outlines)


def _evenly(numbers: list[int]) -> list[int]:
    return [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, min(len(numbers), MOST)).round().astype(int))]


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


def _single_views(views: Sequence[str], cameras: Sequence[Camera], outlines: Mapping[int, NDArray]) -> OutlineDoubt | None:
    """Views that fit the others only when they are turned; of many, each group is spread over all."""
    numbers = list(outlines)
    groups = -(-len(numbers) // MOST)
    said: dict[str, str] = {}
    for first in range(groups):
        part = numbers[first::groups]
        listed, points = [cameras[k] for k in part], np.stack([outlines[k] for k in part])
        said |= {views[part[k]]: words for k, words in _turned_views(listed, points).items()}
    if not said or len(said) > FEW * len(numbers):
        return None
    which = "; ".join(f"{view} ({words})" for view, words in sorted(said.items()))
    return OutlineDoubt(
        f"a camera does not fit the outlines in the other views: {which}: check its pose, and that picture and mask are of "
        "this view",
        tuple(sorted(said)),
    )


def _turned_views(cameras: Sequence[Camera], outlines: NDArray[np.float64]) -> dict[int, str]:
    pairs, errors = tangent_errors(cameras, outlines)
    each = np.array([_error_of(k, pairs, errors) for k in range(len(cameras))])
    typical = float(np.median(each))
    odd = np.nonzero(each > max(2 * ROUNDING, STANDS_OUT * typical))[0]
    said: dict[int, str] = {}
    if len(odd) > max(1, FEW * len(cameras)):
        return said
    for k in odd:
        others = [j for j in range(len(cameras)) if j not in odd]
        degrees, left = _best_turn(int(k), others, cameras, outlines)
        if degrees > LEAST_TURN_DEG and left <= max(2 * ROUNDING, 2 * typical):
            said[int(k)] = f"{each[k]:.1f} px off; turned by {degrees:.1f} degrees it would fit"
    return said


def _error_of(view: int, pairs: NDArray[np.intp], errors: NDArray[np.float64]) -> float:
    own = np.abs(errors[(pairs == view).any(1)])
    return float(np.median(own)) if own.size else 0.0


def _best_turn(
    view: int, others: Sequence[int], cameras: Sequence[Camera], outlines: NDArray[np.float64]
) -> tuple[float, float]:
    """The turn (degrees) of one camera that fits the others' outlines best, and its error then (pixels)."""
    camera, rest = cameras[view], [cameras[k] for k in others]
    points = outlines[[view, *others]]
    pairs = np.array([(0, k) for k in range(1, len(points))], np.intp)

    def error(vector: NDArray[np.float64]) -> float:
        _, errors = tangent_errors([turned(camera, vector), *rest], points, pairs)
        kept = int(KEPT * 2 * len(rest))
        return float(np.sort(np.abs(errors), axis=None)[:kept].mean()) if errors.size >= kept else float("inf")

    step = 0.1 * max(camera.width, camera.height) / camera.fx
    start = np.concatenate([np.zeros((1, 3)), step * np.eye(3)])
    fine = minimize(error, start[0], method="Nelder-Mead", options={"initial_simplex": start, "maxfev": 300, "xatol": 1e-5})
    return float(np.degrees(np.linalg.norm(fine.x))), float(fine.fun)
