"""Do views fall into two groups, each of which fits its cameras and not the other? Then two objects are shown, or two poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ROUNDS = 20
"""In which views change sides, one by one, while that makes more pairs agree."""


@dataclass(frozen=True)
class Groups:
    """Views in two groups.

    Fields:
        second: True for the views of the second. [V]
        within, across: share of the judged pairs that fit, of the same group and of both.
    """

    second: NDArray[np.bool_]
    within: float
    across: float

    def same(self, pairs: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which pairs of views [P, 2] are of one group. [P]"""
        return np.asarray(self.second[pairs[:, 0]] == self.second[pairs[:, 1]])

    @property
    def smaller(self) -> int:
        """Views of the smaller group."""
        return int(min(self.second.sum(), (~self.second).sum()))


def two_groups(count: int, pairs: NDArray[np.intp], fits: NDArray[np.bool_]) -> Groups:
    """Divide views so that pairs within a group fit and pairs across do not, as far as can be.

    Args:
        count: of views.
        pairs: that were judged. [P, 2]
        fits: whether they fit. [P]

    Returns:
        The division; its second group may be empty.
    """
    votes = np.zeros((count, count))
    votes[pairs[:, 0], pairs[:, 1]] = np.where(fits, 1.0, -1.0)
    votes += votes.T
    side = np.where(np.linalg.eigh(votes)[1][:, -1] < 0, -1.0, 1.0)
    for _ in range(ROUNDS):
        gain = -side * (votes @ side)
        worst = int(gain.argmax())
        if gain[worst] <= 0:
            break
        side[worst] *= -1
    second = side != side[0]
    same = second[pairs[:, 0]] == second[pairs[:, 1]]
    within, across = (float(fits[chosen].mean()) if chosen.any() else 0.0 for chosen in (same, ~same))
    return Groups(second, within, across)
