"""Which of the cameras' distances to believe: where two cannot both be true, the one that other cameras bear out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from .map_view import MapView, inside_frame

Float = NDArray[np.float64]


def believed(
    views: Sequence[MapView],
    distances: Sequence[Float],
    supports: Sequence[Float],
    hull_chords: Sequence[tuple[Float, Float]],
    slack: float,
) -> list[Float]:
    """The distances [H, W] without those that lie off the hull or that a better borne out one contradicts (0).

    A point that lies before what another camera sees there would hide it: one of the two is wrong, and the one of less
    support [H, W] (see `depths.supports`) goes, whichever camera has it.

    slack: distances of one surface differ by less than this between cameras (world units).
    """
    within = [
        (d > 0) & (near > 0) & (d > near - 2 * slack) & (d < far + 2 * slack) for d, (near, far) in zip(distances, hull_chords)
    ]
    shapes = [each.shape for each in within]
    firsts = np.cumsum([0, *(each.size for each in within)])
    hiding, hidden = [], []  # numbers of pixels, over all cameras, of which one would hide the other
    for k, view in enumerate(views):
        rows, columns = np.nonzero(within[k])
        points = view.camera.centre + view.camera.rays()[rows, columns] * distances[k][rows, columns][:, None]
        mine = firsts[k] + rows * shapes[k][1] + columns
        for j, other in enumerate(views):
            if j == k:
                continue
            at, clash = _hiding(other, np.where(within[j], distances[j], 0.0), points, slack)
            hiding.append(mine[clash])
            hidden.append((firsts[j] + at[0] * shapes[j][1] + at[1])[clash])
    gone = _beaten(np.concatenate(hiding), np.concatenate(hidden), np.concatenate([s.ravel() for s in supports]))
    # points that fall on a camera whose pixels are finer leave gaps between them
    lost = [
        ndimage.binary_closing(gone[first : first + size[0] * size[1]].reshape(size), np.ones((3, 3)))
        for first, size in zip(firsts, shapes)
    ]
    return [np.where(each & ~out, distance, 0.0) for each, out, distance in zip(within, lost, distances)]


def _beaten(ones: NDArray[np.int64], others: NDArray[np.int64], support: Float) -> NDArray[np.bool_]:
    """Which pixels [N] go, where of each pair of pixels one must: those of less support than one that stays itself."""
    rank = np.empty(len(support), np.int64)
    rank[np.argsort(support, kind="stable")] = np.arange(len(support))
    first = rank[ones] >= rank[others]
    winner, loser = np.where(first, ones, others), np.where(first, others, ones)
    lost = np.zeros(len(support), bool)
    while len(winner):
        doubted = np.zeros(len(support), bool)
        doubted[loser] = True
        settled = ~doubted[winner]  # the best of all that are left always is
        lost[loser[settled]] = True
        left = ~settled & ~lost[winner] & ~lost[loser]
        winner, loser = winner[left], loser[left]
    return lost


def _hiding(
    view: MapView, distance: Float, points: Float, slack: float
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], NDArray[np.bool_]]:
    """Rows and columns [N] of the pixels that points [N, 3] fall on, and whether the points would hide what is seen there."""
    pixels, away = view.project(points)
    inside = inside_frame(pixels, view.camera.width, view.camera.height)
    nearest = np.round(np.nan_to_num(pixels)).astype(np.int64)
    column, row = (np.clip(nearest[:, axis], 0, size - 1) for axis, size in enumerate(distance.shape[::-1]))
    there = np.where(inside, distance[row, column], 0.0)
    with np.errstate(invalid="ignore"):
        return (row, column), (there > 0) & (away < there - 3 * slack)
