"""Points that several pictures show: SIFT, matched both ways, where they move from picture to picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import srgb_encode
from pipeline.geometry.cameras import Camera

LONGEST = 640
"""Pixels of the longer side at which features are found."""
FEATURES = 600
CONTRAST = 0.02
"""Half of SIFT's usual threshold: rendered and smooth objects have little."""
RATIO = 0.8
"""Of the best match's distance to the next one's (Lowe 2004)."""
STILL_PX = 1.5
"""What does not move between two views is a background before which the object turns, or dirt on the sensor."""
MARGIN = 0.01
"""Of the longer side, inside a mask's edge: outlines are of another place in each view."""
PAIR = 8
"""Matches of a pair below which they are chance."""
OPPOSITE = -0.3
"""Cosine between viewing axes (107 degrees) below which two views hardly share a surface."""


@dataclass(frozen=True)
class Matches:
    """Matches of several pairs of pictures.

    Fields:
        pairs: the pictures of each match. [M, 2]
        first, second: its pixels, centres at +0.5. [M, 2]
        features: how many different points of pictures are among them.
    """

    pairs: NDArray[np.intp]
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    features: int

    def some(self, most: int) -> Matches:
        """Choose at most so many of them, evenly."""
        chosen = slice(None, None, -(-len(self.pairs) // most) or 1)
        return replace(self, pairs=self.pairs[chosen], first=self.first[chosen], second=self.second[chosen])


def beyond_chance(matches: Matches, cameras: Sequence[Camera]) -> Matches:
    """Choose the matches of pairs that have more of them than pairs that look from opposite sides, whose matches are chance.

    Args:
        matches: of the pictures.
        cameras: one a picture.
    """
    pairs, which, count = np.unique(matches.pairs, axis=0, return_inverse=True, return_counts=True)
    axes = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    opposite = (axes[pairs[:, 0]] * axes[pairs[:, 1]]).sum(1) < OPPOSITE
    chance = max(int(count[opposite].max(initial=0)), PAIR)
    kept = count[which.reshape(-1)] > chance
    return replace(matches, pairs=matches.pairs[kept], first=matches.first[kept], second=matches.second[kept])


def features(
    radiance: NDArray[np.float32], mask: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float64], NDArray[np.float32], tuple[int, int]]:
    """Find SIFT features of a picture.

    Args:
        radiance: linear, grey. [H, W]
        mask: True where to look; None: everywhere. [H, W]

    Returns:
        Pixels [N, 2] (centres at +0.5) and descriptors [N, 128] of unit length at the size at which they were found, and
        that size (width, height).
    """
    scale = min(1.0, LONGEST / max(radiance.shape))
    size = (max(1, round(radiance.shape[1] * scale)), max(1, round(radiance.shape[0] * scale)))
    grey = np.maximum(np.nan_to_num(radiance, posinf=0, neginf=0), 0)
    inside: Any = None if mask is None else mask.astype(np.uint8)
    if scale < 1:
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        inside = None if inside is None else cv2.resize(inside, size, interpolation=cv2.INTER_NEAREST)
    if inside is not None:
        steps = max(2, round(MARGIN * max(size)))
        inside = cv2.erode(inside, np.ones((3, 3), np.uint8), iterations=steps, borderValue=0)
    part = grey if inside is None else grey[inside > 0]
    top = float(np.percentile(part, 99)) if part.size else 0.0
    nothing = np.zeros((0, 2)), np.zeros((0, 128), np.float32), size
    if top <= 0:
        return nothing
    picture = (srgb_encode(np.clip(grey / top, 0, 1)) * 255 + 0.5).astype(np.uint8)
    found, descriptors = cv2.SIFT.create(nfeatures=FEATURES, contrastThreshold=CONTRAST).detectAndCompute(picture, inside)
    if descriptors is None or len(found) < PAIR:
        return nothing
    rooted = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9))  # Arandjelovic and Zisserman 2012
    return np.array([f.pt for f in found]) + 0.5, rooted.astype(np.float32), size


def matched(points: Sequence[NDArray[np.float64]], descriptors: Sequence[NDArray[np.float32]]) -> Matches:
    """Match the features of every pair of pictures.

    Args:
        points: pixels of each picture's features. [N, 2] each
        descriptors: of unit length. [N, 128] each

    Returns:
        What is the best both ways, stands out, and moves.
    """
    found: dict[tuple[int, int], NDArray[np.intp]] = {}
    for i, j in combinations(range(len(points)), 2):
        if min(len(points[i]), len(points[j])) < PAIR:
            continue
        both = _both_ways(descriptors[i] @ descriptors[j].T)
        moves = np.linalg.norm(points[i][both[:, 0]] - points[j][both[:, 1]], axis=1) > STILL_PX
        if moves.sum() >= PAIR:
            found[i, j] = both[moves]
    return _together(points, found)


def _together(points: Sequence[NDArray[np.float64]], found: Mapping[tuple[int, int], NDArray[np.intp]]) -> Matches:
    if not found:
        return Matches(np.zeros((0, 2), np.intp), np.zeros((0, 2)), np.zeros((0, 2)), 0)
    pairs = np.concatenate([np.tile(np.array(pair, np.intp), (len(both), 1)) for pair, both in found.items()])
    first = np.concatenate([points[i][both[:, 0]] for (i, _), both in found.items()])
    second = np.concatenate([points[j][both[:, 1]] for (_, j), both in found.items()])
    numbers = np.concatenate(list(found.values()))
    used = np.unique(np.stack([pairs.ravel(), numbers.ravel()], 1), axis=0)
    return Matches(pairs, first, second, len(used))


def _both_ways(likeness: NDArray[np.float32]) -> NDArray[np.intp]:
    """Numbers [M, 2] of features that are each other's best match and stand out, of cosines [N, K]."""
    best, back = likeness.argmax(1), likeness.argmax(0)
    rows = np.arange(len(best))
    nearest = likeness[rows, best]
    rest = likeness.copy()
    rest[rows, best] = -1
    apart = 2 - 2 * np.stack([nearest, rest.max(1)])  # squared distances
    kept = (back[best] == rows) & (apart[0] < RATIO**2 * apart[1])
    return np.stack([rows[kept], best[kept]], 1)
