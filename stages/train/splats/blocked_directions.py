"""In which directions a surface's surroundings lie, as far as some rays of its own have told: most rays need not be cast."""

from __future__ import annotations

import numpy as np

from .direction_kernels import doubtful, mark

MOST_CELLS = 64  # along the longest side


class BlockedDirections:
    """Cells about a surface. Each remembers in which of 64 directions rays met something that began in it or beside it.

    Args:
        points: places on the surface that rays will be cast from. [P, 3]
        width: a cell's; of two spacings of the places that `note` is told of, 36 of them speak for one.
    """

    def __init__(self, points: np.ndarray, width: float) -> None:
        self.low, high = points.min(0).astype(np.float32), points.max(0)
        width = max(width, float((high - self.low).max()) / MOST_CELLS, 1e-9)
        self.scale = np.float32(1 / width)
        shape = (np.floor((high - self.low) / width).astype(int) + 1).clip(1, MOST_CELLS + 1)
        self._own = np.zeros(tuple(shape), np.uint64)
        self.cells = self._own

    def note(self, points: np.ndarray, directions: np.ndarray, met: np.ndarray) -> None:
        """Keep which rays met something [P, K], from points [P, 3] along directions [P, K, 3]."""
        mark(points, directions, met, self.low, self.scale, self._own)

    def settle(self) -> None:
        """After the last `note`: let cells know of their neighbours."""
        self.cells = with_neighbours(self._own)

    def doubtful(self, points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rays from points [P, 3] along [P, K, 3] that something may be in the way of: which of the P K [M], and [M, 6]."""
        count = directions.shape[0] * directions.shape[1]
        rows, rays = np.empty(count, np.int64), np.empty((count, 6), np.float32)
        found = doubtful(points, directions, self.low, self.scale, self.cells, rows, rays)
        return rows[:found], rays[:found]


def with_neighbours(cells: np.ndarray) -> np.ndarray:
    """Bits of cells [X, Y, Z] with those of the 26 around each."""
    out = cells
    for axis in range(3):
        before, out = np.moveaxis(out, axis, 0), out.copy()
        after = np.moveaxis(out, axis, 0)
        after[1:] |= before[:-1]
        after[:-1] |= before[1:]
    return out
