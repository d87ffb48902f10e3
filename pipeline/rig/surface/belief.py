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
    lost = [np.zeros(each.shape, bool) for each in within]
    for k, view in enumerate(views):
        rows, columns = np.nonzero(within[k])
        points = view.camera.centre + view.camera.rays()[rows, columns] * distances[k][rows, columns][:, None]
        mine = supports[k][rows, columns]
        for j, other in enumerate(views):
            if j == k:
                continue
            at, hidden = _hiding(other, np.where(within[j], distances[j], 0.0), points, slack)
            theirs = supports[j][at]
            worse = hidden & (mine < theirs)
            lost[k][rows[worse], columns[worse]] = True
            better = hidden & ~worse
            lost[j][at[0][better], at[1][better]] = True
    # points that fall on a camera whose pixels are finer leave gaps between them
    lost = [ndimage.binary_closing(each, np.ones((3, 3))) for each in lost]
    return [np.where(each & ~gone, distance, 0.0) for each, gone, distance in zip(within, lost, distances)]


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
