"""Which pose belongs to which picture, where their lists were mixed up: the order in which matched points fit."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.geometry.epipolar import essential_matrices
from stages.masks.picture_matches import Matches

POINTS = 40
"""Matches of a pair that are tried on every pair of poses."""
LEAST_POINTS = 12
PAIRS_A_PICTURE = 4
AGREE = 0.7
"""Share of a picture's pairs that a pose must fit."""
SLACK = 2.0
"""Few points of one pair are less sure than all of them together."""
STEPS = 2000
"""Poses that are tried before the search is given up."""


def pose_order(cameras: Sequence[Camera], matches: Matches, kept: float, good_px: float) -> list[int] | None:
    """Find an order of the poses in which matched points fit.

    Args:
        cameras: pinholes, one a picture.
        matches: of the pictures.
        kept: share of a pair's matches that are true at least.
        good_px: mean error of these with which a pair fits.

    Returns:
        The number of each picture's pose; None where none fits most pictures.
    """
    table = _table(cameras, matches, kept, good_px)
    found = _Search(table, len(cameras)).best() if table else {}
    if len(found) < AGREE * len(cameras):
        return None
    free = iter(sorted(set(range(len(cameras))) - set(found.values())))
    return [found[k] if k in found else next(free) for k in range(len(cameras))]


def _table(
    cameras: Sequence[Camera], matches: Matches, kept: float, good_px: float
) -> dict[tuple[int, int], NDArray[np.bool_]]:
    """Of the pairs of pictures with the most matches: which pairs of poses fit. [V, V] each; none where no pair does, as of
    pictures whose matches are chance."""
    chosen, which, count = np.unique(matches.pairs, axis=0, return_inverse=True, return_counts=True)
    strongest = np.argsort(-count, kind="stable")[: PAIRS_A_PICTURE * len(cameras)]
    essential = essential_matrices(cameras)
    table = {}
    for p in strongest[count[strongest] >= LEAST_POINTS]:
        i, j = (int(k) for k in chosen[p])
        own = np.nonzero(which.reshape(-1) == p)[0][:POINTS]
        u, v = _in_plane(cameras[i], matches.first[own]), _in_plane(cameras[j], matches.second[own])
        line, back = np.einsum("abrc,mc->abmr", essential, u), np.einsum("abrc,mr->abmc", essential, v)
        length = np.sqrt((line[..., :2] ** 2).sum(-1) + (back[..., :2] ** 2).sum(-1))
        errors = np.abs((line * v).sum(-1)) / np.maximum(length, 1e-300) * np.sqrt(cameras[i].fx * cameras[j].fx)
        better = np.sort(errors, -1)[..., : max(1, int(kept * len(own)))].mean(-1)
        fits = better <= SLACK * good_px  # never of one place, where nothing is a number
        if fits.any():
            table[i, j] = fits
    return table


def _in_plane(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([(points - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones((len(points), 1))], 1)


@dataclass
class _Search:
    """Depth first; next is always the picture whose pose is least open, and one that no pose fits waits, or is left out."""

    table: dict[tuple[int, int], NDArray[np.bool_]]
    count: int
    left: int = field(default=STEPS)
    found: dict[int, int] = field(default_factory=dict)
    agreeing: int = 0

    def best(self) -> dict[int, int]:
        """Poses by picture, so that the most pairs fit."""
        self._sides: dict[int, list[tuple[int, NDArray[np.bool_]]]] = defaultdict(list)
        for (i, j), fits in self.table.items():
            self._sides[i].append((j, fits))
            self._sides[j].append((i, fits.T))
        first = min(self.table, key=lambda pair: int(self.table[pair].sum()))
        for a, b in np.argwhere(self.table[first]):
            self._extend({first[0]: int(a), first[1]: int(b)}, 1)
        return self.found

    def _extend(self, found: dict[int, int], agreeing: int) -> None:
        """Find poses for the other pictures too."""
        self.left -= 1
        if agreeing > self.agreeing:
            self.found, self.agreeing = found, agreeing
        picture, poses, gain = self._next(found)
        for pose in poses:
            if self.left <= 0 or (self.agreeing >= AGREE * len(self.table) and len(self.found) == self.count):
                return
            self._extend({**found, picture: pose}, agreeing + gain)

    def _next(self, found: dict[int, int]) -> tuple[int, list[int], int]:
        """The picture with the fewest poses that fit those found (of these, with the most pairs); its poses, and how many of
        its pairs agree with each."""
        taken, best = list(found.values()), (-1, list[int](), 0)
        for picture in sorted(set(self._sides) - set(found)):
            sides = [fits[:, found[other]] for other, fits in self._sides[picture] if other in found]
            if not sides:
                continue
            votes = np.sum(sides, 0)
            votes[taken] = 0
            gain = int(votes.max())
            if gain < AGREE * len(sides):
                continue
            poses = np.nonzero(votes == gain)[0].tolist()
            if not best[1] or (len(poses), -gain) < (len(best[1]), -best[2]):
                best = (picture, poses, gain)
        return best
