"""Which pose belongs to which picture, where their lists were mixed up: the order in which matched points fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
STEPS = 5000
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
    if not table:
        return None
    search = _Search(table, len(cameras))
    found = next(search.orders({}, search.sequence()), None)
    if found is None or len(found) < AGREE * len(cameras):
        return None
    free = iter(sorted(set(range(len(cameras))) - set(found.values())))
    return [found[k] if k in found else next(free) for k in range(len(cameras))]


def _table(
    cameras: Sequence[Camera], matches: Matches, kept: float, good_px: float
) -> dict[tuple[int, int], NDArray[np.bool_]]:
    """Of the pairs of pictures with the most matches: which pairs of poses fit. [V, V] each"""
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
        table[i, j] = better <= SLACK * good_px  # never of one place, where nothing is a number
    return table


def _in_plane(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([(points - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones((len(points), 1))], 1)


@dataclass
class _Search:
    """Depth first, a picture after the other, each with those before it."""

    table: dict[tuple[int, int], NDArray[np.bool_]]
    count: int
    left: int = field(default=STEPS)

    def sequence(self) -> list[int]:
        """Pictures, each connected as well as can be to those before it; what is not connected is left out."""
        degree = np.zeros((self.count, self.count), int)
        for i, j in self.table:
            degree[i, j] = degree[j, i] = 1
        order = [int(degree.sum(1).argmax())]
        while True:
            links = degree[order].sum(0)
            links[order] = 0
            if not links.any():
                return order
            order.append(int(links.argmax()))

    def orders(self, found: dict[int, int], rest: Sequence[int]) -> Iterator[dict[int, int]]:
        """Poses by picture, for all of `rest`, with those that are found already."""
        if not rest:
            yield found
            return
        picture = rest[0]
        fits, pairs = np.zeros(self.count, int), 0
        for other, pose in found.items():
            if (picture, other) in self.table:
                fits, pairs = fits + self.table[picture, other][:, pose], pairs + 1
            elif (other, picture) in self.table:
                fits, pairs = fits + self.table[other, picture][pose], pairs + 1
        fits[list(found.values())] = -1
        for pose in np.argsort(-fits, kind="stable"):
            if fits[pose] < AGREE * pairs or self.left <= 0:
                return
            self.left -= 1
            yield from self.orders({**found, picture: int(pose)}, rest[1:])
