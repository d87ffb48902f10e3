"""One pass over a Stokes image for all that decode asks of it: an image of 12 megapixels is 430 MB."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(nogil=True, cache=True)
def _survey(stokes: NDArray[np.float32], mend: bool) -> tuple[int, int, np.float32]:
    """(pixels with a negative s0, pixels with |(s1, s2)| > s0, largest s0) of [H, W, 3, 3]; `mend` projects both in place."""
    negative, impossible, top = 0, 0, np.float32(0)
    for y in range(stokes.shape[0]):
        for x in range(stokes.shape[1]):
            below, above = False, False
            for c in range(3):
                s0, s1, s2 = stokes[y, x, 0, c], stokes[y, x, 1, c], stokes[y, x, 2, c]
                top = max(top, s0)
                if s0 < 0:
                    below = True
                    if mend:
                        stokes[y, x, 0, c] = stokes[y, x, 1, c] = stokes[y, x, 2, c] = 0
                elif s1 * s1 + s2 * s2 > s0 * s0:
                    above = True
                    if mend:
                        factor = s0 / np.sqrt(s1 * s1 + s2 * s2)
                        stokes[y, x, 1, c] = s1 * factor
                        stokes[y, x, 2, c] = s2 * factor
            negative += below
            impossible += above and not below
    return negative, impossible, top


def count_unphysical(stokes: NDArray[np.float32]) -> tuple[int, int]:
    """Pixels with a negative s0, and with more polarised light than light, in any colour of [H, W, 3, 3]."""
    negative, impossible, _ = _survey(stokes, False)
    return negative, impossible


def make_physical(stokes: NDArray[np.float32]) -> tuple[int, int]:
    """Solved Stokes vectors onto the cone of possible ones, in place: s0 >= 0, |(s1, s2)| <= s0. Returns both counts."""
    negative, impossible, _ = _survey(stokes, True)
    return negative, impossible
