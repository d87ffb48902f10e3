"""Are given cameras those of these pictures? Matched points tell, where there are any, whatever the outlines say."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import some
from pipeline.geometry.camera_slips import likeliest, posed
from pipeline.geometry.cameras import Camera
from pipeline.geometry.epipolar import sampson_errors
from pipeline.geometry.odd_cameras import odd_cameras
from stages.masks.outline_check import groups_said
from stages.masks.picture_groups import picture_groups
from stages.masks.picture_matches import Matches, beyond_chance, features, matched
from stages.masks.pose_order import pose_order

MOST, BLOCK = 40, 4
"""Views that are looked at; of more, blocks of so many that follow each other, spread evenly, as these see the same things."""
MEGAPIXELS = 100
"""That are read, if that is at least three blocks."""
FEWEST_MATCHES, FEWEST_FEATURES = 60, 40
"""Below which nothing is said."""
FEWEST_OF_ONE = 20
"""Matches of one camera that tell of it."""
MOST_MATCHES = 4000
"""On which mistakes are tried: more say no more."""
KEPT = 0.4
"""Share of the matches that are true at least, where they are of use (synthetic captures: 0.5 to 0.8)."""
LOCATED = 0.5
"""Pixels to which features are found: mean error of the better part of the matches, up to which cameras fit. What moves with
the view, as mirror images do, fits no cameras so well (mirrors of three environments: 1 to 3 px with the best)."""
OF_ONE, FAR = 0.5, 2.0
"""Share of one camera's matches that are true, and pixels that they must be off, for it to be doubted: where most matches of
a view are wrong, a turn makes the few best of them fit by chance (0.9 px in a sound capture)."""
LOG_ODDS, LEAST_GAIN = 10.0, 1.5
"""As for outlines, of Laplacian errors; each match is of two features, and as many are independent."""


@dataclass(frozen=True)
class Evidence:
    """Errors of matches."""

    matches: Matches

    def __call__(self, cameras: Sequence[Camera], view: int | None = None) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Pairs [M, 2] and Sampson errors [M], pixels, of all matches or of those that hold `view`."""
        m = self.matches
        chosen = slice(None) if view is None else (m.pairs == view).any(1)
        return m.pairs[chosen], sampson_errors(cameras, m.pairs[chosen], m.first[chosen], m.second[chosen])


def picture_doubt(
    cameras: Mapping[str, Camera],
    picture: Callable[[str], NDArray[np.float32]],
    masks: Mapping[str, NDArray[np.bool_]],
) -> str | None:
    """Hold pinhole cameras against the pictures of one still object.

    Args:
        cameras: by view.
        picture: reads a view's radiance, grey. [H, W]
        masks: True where to look, by view; a view without one is looked at all over. [H, W] each

    Returns:
        The mistake that explains why they do not fit, in words with figures; None where they fit, where no mistake explains
        it, and where matches are too few.
    """
    views = sorted(cameras)
    views = [views[k] for k in chosen_views([cameras[view].width * cameras[view].height for view in views])]
    looked, points, descriptors = {}, [], []
    for view in views:
        radiance, mask = picture(view), masks.get(view)
        fits = mask is not None and mask.shape == radiance.shape
        pixels, described, (width, height) = features(radiance, mask if fits else None)
        looked[view] = cameras[view].resized(width, height)
        points.append(pixels)
        descriptors.append(described)
    return matches_doubt(looked, matched(points, descriptors))


def matches_doubt(cameras: Mapping[str, Camera], matches: Matches) -> str | None:
    """Hold pinhole cameras against matched points.

    Args:
        cameras: by view, in the order of the matches' numbers.
        matches: of their pictures.

    Returns:
        As `picture_doubt`.
    """
    count = len(matches.pairs)
    if count < FEWEST_MATCHES or matches.features < FEWEST_FEATURES:
        return None
    listed = list(cameras.values())
    few = Evidence(matches.some(MOST_MATCHES))

    def error(tried: Sequence[Camera]) -> float:
        errors = np.sort(few(tried)[1])
        return float(errors[: int(KEPT * len(errors))].mean())

    as_given = error(listed)
    limit = min(LOCATED, as_given / max(LEAST_GAIN, float(np.exp(2 * LOG_ODDS / matches.features))))
    off = f"the cameras do not fit what the pictures show, {count} matched points of which are {as_given:.1f} px off"
    if as_given > LOCATED / 4:
        slip, left = likeliest(listed, error)
        if left <= limit:
            return f"{off}: {slip} (then {left:.1f} px)"
    second = picture_groups(listed, matches, KEPT, 2 * LOCATED)
    if second is not None:
        return f"the cameras do not fit what the pictures show: {groups_said(list(cameras), second)}"
    if as_given <= LOCATED:
        return _of_one(list(cameras), listed, Evidence(beyond_chance(matches, listed)))
    order = pose_order(listed, matches, KEPT, LOCATED)
    if order is None or (left := error([posed(camera, listed[k]) for camera, k in zip(listed, order)])) > limit:
        return None
    views = list(cameras)
    moved = [f"{view} that of {views[k]}" for view, k in zip(views, order) if views[k] != view]
    fits = f"poses in another order fit (such as {some(moved)})"
    return f"{off}: {fits}: check which pose belongs to which picture (then {left:.1f} px)"


def _of_one(views: Sequence[str], cameras: Sequence[Camera], evidence: Evidence) -> str | None:
    odd = odd_cameras(cameras, evidence, OF_ONE, LOCATED, FAR, FEWEST_OF_ONE)
    if not odd:
        return None
    which = "; ".join(f"{views[k]} ({words})" for k, words in odd.items())
    return f"a camera does not fit what the other views show: {which}: check its pose, and that the picture is of this view"


def chosen_views(pixels: Sequence[int]) -> list[int]:
    """Choose the views that are looked at, by number.

    Args:
        pixels: of every view, in their order.
    """
    most = int(min(MOST, max(3 * BLOCK, MEGAPIXELS * 1e6 / max(pixels))))
    if len(pixels) <= most:
        return list(range(len(pixels)))
    starts = np.linspace(0, len(pixels) - BLOCK, most // BLOCK).round().astype(int)
    return sorted({int(start) + k for start in starts for k in range(BLOCK)})
