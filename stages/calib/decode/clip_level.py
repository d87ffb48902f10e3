"""Where float images were clipped: many samples share exactly the largest value, few lie just below it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MIN_SAMPLES = 6
"""Fewer equal maxima happen by chance in half-float files, whose values are 2^-11 apart."""
BELOW = 0.97
"""Clipping empties no bin below the level: the plateau must outnumber the samples of the last 3 %."""


def clip_level(image: NDArray[np.float32]) -> float | None:
    """The level at which [H, W, ..] was clipped, or None. A black image is not clipped; large ones are sampled by rows."""
    if image.ndim > 1 and image.size > SAMPLED:
        image = np.ascontiguousarray(image[:: image.size // SAMPLED + 1])
    search = PlateauSearch()
    search.add(image)
    return search.level()


def top_of(image: NDArray[np.float32]) -> tuple[float, int, int]:
    """Largest sample of a frame [..], how many are as large, and how many lie just below."""
    top = float(image.max(initial=0.0))
    if not top > 0:
        return top, image.size, 0
    at_top = int(np.count_nonzero(image == np.float32(top)))
    return top, at_top, int(np.count_nonzero(image >= np.float32(BELOW * top))) - at_top


SAMPLED = 1 << 21
"""Samples that settle the question; a plateau that they miss is a speck."""


class PlateauSearch:
    """The same question over many frames of one exposure, one frame at a time."""

    def __init__(self) -> None:
        self.tops: list[tuple[float, int, int]] = []

    def add(self, image: NDArray[np.float32]) -> None:
        """Remember the top of one frame [..]."""
        self.tops.append(top_of(image))

    def level(self) -> float | None:
        """The shared clip level, or None."""
        top = max((t for t, _, _ in self.tops), default=0.0)
        if not top > 0 or not np.isfinite(top):
            return None
        equal = sum(n for t, n, _ in self.tops if t == top)
        near = sum(n for t, _, n in self.tops if t == top) + sum(n for t, n, _ in self.tops if BELOW * top <= t < top)
        return top if equal >= MIN_SAMPLES and equal > near else None
