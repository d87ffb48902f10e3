"""Was a display's curve laid over these 16-bit codes? Some files betray it: 8 bits saved as 16, and gaps that narrow upwards.

Codes of a sensor's 12 or 14 bits lie evenly apart while they are linear. Under sRGB's curve their gaps become twelve times as
wide in the dark as in the light, and no scaling does that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

EIGHT_BITS = 257
"""8-bit codes are multiples of it when they are saved as 16."""
DARK, BRIGHT = (1300, 6500), (36_000, 62_000)
"""Codes that are compared: sRGB's slope is 13 to 6 in the first, 0.9 to 0.5 in the second."""
FEWEST, REPEATED = 32, 5
"""Different codes of a part, and samples of its typical code: then nearly every code that may occur does."""
NARROWER = 4.0
"""How many times wider the gaps in the dark must be; sRGB makes it 12, a linear file 1."""
WIDEST_SPREAD = 2.5
"""Upper over lower quartile of the gaps of a comb; of colours picked at random it is more."""


def curve_in_codes(images: Sequence[NDArray[np.uint16]]) -> str | None:
    """Say by what 16-bit codes betray that they are no linear light.

    Args:
        images: codes. [..] each

    Returns:
        The evidence in words; None where there is none, as in most files.
    """
    total = np.zeros(1 << 16, np.int64)
    for codes in images:
        total += np.bincount(codes.ravel(), minlength=1 << 16)
    used = np.flatnonzero(total)
    if len(used) >= FEWEST and not (used % EIGHT_BITS).any():
        return "hold 8 bits a sample, as pictures for the eye do that were saved as 16"
    dark, bright = _gap(total, DARK), _gap(total, BRIGHT)
    if dark is not None and bright is not None and dark > NARROWER * bright:
        return f"use codes {dark:.0f} apart in the dark and {bright:.0f} in the light, as a display's curve spreads a sensor's"
    return None


def _gap(total: NDArray[np.int64], part: tuple[int, int]) -> float | None:
    """The typical gap between the codes in use of a part; None where they are no comb, or too few to tell."""
    used = np.flatnonzero(total[slice(*part)])
    if len(used) < FEWEST or np.median(total[slice(*part)][used]) < REPEATED:
        return None
    low, middle, high = np.percentile(np.diff(used), (25, 50, 75))
    return float(middle) if high <= WIDEST_SPREAD * low else None
