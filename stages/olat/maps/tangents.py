"""Tangents that a pixel's neighbours bear out: one among neighbours that have none is a chance mean of unrelated directions.

A surface whose tangents vary smoothly has a tangent in pixel after pixel. Where a dozen faces with tangents of their own share
a pixel, one in fifty comes out with a preferred direction by chance, some 15 degrees off what a mean over its faces would be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EDGE = np.cos(np.radians(45.0))  # neighbours whose normals differ more are another surface
QUORUM = 0.25  # of the neighbours on the same surface: fewer with a tangent do not bear it out
STEPS = ((0, 1), (1, -1), (1, 0), (1, 1))  # to half of a pixel's eight neighbours: the others see it the same way


def borne_out(normals: NDArray[np.float64], directed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which pixels of `directed` [H, W] (those with a tangent) keep it, by the normals [H, W, 3] (0 outside the object).

    A pixel without neighbours on its surface keeps what it has.
    """
    near, with_tangent = np.zeros(directed.shape), np.zeros(directed.shape)
    for down, right in STEPS:
        one, other = _overlap(directed.shape, down, right), _overlap(directed.shape, -down, -right)
        same = np.einsum("...k,...k->...", normals[one], normals[other]) > EDGE
        for here, there in ((one, other), (other, one)):
            near[here] += same
            with_tangent[here] += same & directed[there]
    return directed & (with_tangent >= QUORUM * near)


def _overlap(shape: tuple[int, ...], down: int, right: int) -> tuple[slice, slice]:
    """The part of an image that a copy moved by (down, right) covers, in the copy's own place."""
    rows, columns = (slice(max(-move, 0), size - max(move, 0)) for move, size in zip((down, right), shape))
    return rows, columns
