"""What a set of lines, such as the viewing axes of cameras, has in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MOST_PARALLEL = 1e6
"""Condition of the normal equations from which lines count as parallel: half of a float64's digits are lost there."""


def nearest_to_lines(origins: NDArray, directions: NDArray) -> NDArray[np.float64] | None:
    """Find the point nearest to all of a set of lines, in the least-squares sense.

    Args:
        origins: a point on each line. [N, 3]
        directions: unit. [N, 3]

    Returns:
        The point, in the origins' units; None where the lines are parallel, as one alone is. [3]
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    total = across.sum(0)
    if np.linalg.cond(total) > MOST_PARALLEL:
        return None
    return np.linalg.solve(total, (across @ origins[:, :, None]).sum(0)[:, 0])
