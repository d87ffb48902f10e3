"""The lights of a light stage, however their table was written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class LightTable:
    """The lights of a light stage, in the world of its cameras.

    Fields:
        directions: unit, from the stage's centre to each light. [N, 3]
        positions: world units. [N, 3]
        intensity: relative. [N]
        solid_angle: sr; None: to be computed from the directions. [N]
        index: the table's own number of each light, which its frame bears; None: 0..N-1. [N]
        names: the file of each light's frame, where the table names it.
        colour: of each light, relative to its own mean; None: white. [N, 3]
    """

    directions: NDArray[np.float64]
    positions: NDArray[np.float64]
    intensity: NDArray[np.float64]
    solid_angle: NDArray[np.float64] | None = None
    index: NDArray[np.int64] | None = None
    names: tuple[str, ...] | None = None
    colour: NDArray[np.float64] | None = None

    @property
    def gains(self) -> NDArray[np.float64]:
        """What each channel of a light's frame is multiplied by to make the light white [N, 3]."""
        return np.ones((len(self), 3)) if self.colour is None else 1.0 / self.colour

    def __len__(self) -> int:
        return len(self.directions)
