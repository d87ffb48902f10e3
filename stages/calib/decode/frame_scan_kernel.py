"""One pass over a Stokes image for all that decode asks of it: an image of 12 megapixels is 430 MB."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.kernels.compiling import kernel

INFINITE = np.float32(np.inf)


@kernel(nogil=True)
def _survey(stokes: NDArray[np.float32], mend: bool) -> tuple[int, int, np.float32]:
    """(pixels with a negative s0, pixels with |(s1, s2)| > s0, largest magnitude) of [H, W, 3, 3].

    `mend` projects both kinds in place; the magnitude is that of what is left, but infinite where anything was.
    """
    negative, impossible, top = 0, 0, np.float32(0)
    for y in range(stokes.shape[0]):
        for x in range(stokes.shape[1]):
            below, above = False, False
            for c in range(3):
                s0, s1, s2 = stokes[y, x, 0, c], stokes[y, x, 1, c], stokes[y, x, 2, c]
                if not mend:
                    top = max(top, max(abs(s0), max(abs(s1), abs(s2))))
                elif s0 > top:  # the others are no larger, once mended
                    top = s0
                if s0 < 0:
                    below = True
                    if mend:
                        top = max(top, INFINITE) if np.isinf(s0) else top
                        stokes[y, x, 0, c] = stokes[y, x, 1, c] = stokes[y, x, 2, c] = 0
                elif s1 * s1 + s2 * s2 > s0 * s0:
                    above = True
                    if mend:
                        top = max(top, INFINITE) if np.isinf(s1) or np.isinf(s2) else top
                        factor = s0 / np.sqrt(s1 * s1 + s2 * s2)
                        stokes[y, x, 1, c] = s1 * factor
                        stokes[y, x, 2, c] = s2 * factor
            negative += below
            impossible += above and not below
    return negative, impossible, top


@dataclass(frozen=True)
class Survey:
    """Pixels with a negative s0, with more polarised light than light (in any colour), and the largest magnitude."""

    negative: int
    impossible: int
    peak: float


def _as_survey(negative: int, impossible: int, peak: np.float32) -> Survey:
    return Survey(negative, impossible, float(peak))


def count_unphysical(stokes: NDArray[np.float32]) -> Survey:
    """What [H, W, 3, 3] holds."""
    return _as_survey(*_survey(stokes, False))


def make_physical(stokes: NDArray[np.float32]) -> Survey:
    """Solved Stokes vectors onto the cone of possible ones, in place: s0 >= 0, |(s1, s2)| <= s0. What was mended."""
    return _as_survey(*_survey(stokes, True))
