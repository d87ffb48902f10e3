"""The lights of a light stage, however their table was written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class LightTable:
    """Directions from the stage's centre to each light (world, unit) [N, 3], positions [N, 3] in world units,
    relative intensity [N], solid angle [N] in sr (None: to be computed from the directions). index [N]: the table's own
    number of each light, which its frame bears (None: 0..N-1); names: the file of each light's frame, where it tells."""

    directions: NDArray[np.float64]
    positions: NDArray[np.float64]
    intensity: NDArray[np.float64]
    solid_angle: NDArray[np.float64] | None = None
    index: NDArray[np.int64] | None = None
    names: tuple[str, ...] | None = None

    def __len__(self) -> int:
        return len(self.directions)
