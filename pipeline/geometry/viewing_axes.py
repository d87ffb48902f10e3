"""Where cameras look."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.axes import nearest_to_lines

if TYPE_CHECKING:
    from pipeline.geometry.cameras import Camera


def looked_at(cameras: Iterable[Camera]) -> NDArray[np.float64]:
    """The point [3] nearest to all viewing axes; the centres' mean where the axes are parallel."""
    listed = list(cameras)
    centres = np.stack([c.centre for c in listed])
    middle = centres.mean(0)  # taken out first: world coordinates may be large
    found = nearest_to_lines(centres - middle, np.stack([c.world_to_camera[2, :3] for c in listed]))
    return middle if found is None else middle + found
