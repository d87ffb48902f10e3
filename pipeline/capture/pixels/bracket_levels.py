"""Do the pictures of an exposure bracket keep the ratio of their times? A black level adds the same to each of them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

SAMPLES = 200_000
DARKEST = 0.02
"""Of the white level: below it noise that is cut off at 0 is no longer even about the true light."""
LEAST_LEVEL = 1 / 256
"""Of the white level, from which a black level is worth a word: 16 codes of 12 bits."""
LEAST_RATIO = 0.15
"""Of the ratio of two times: shutters and the numbers that cameras round them to are off by less."""
SIGMAS = 5.0
PARTS = 16
"""Strips of the picture whose scatter tells the errors: neighbours err alike."""
SPREAD = 2.0
"""Of the light's 95th over its 5th percentile: an even picture cannot tell a level from a ratio."""


def bracket_doubt(
    images: Sequence[NDArray[np.float32]], saturated: Sequence[NDArray[np.bool_]], seconds: Sequence[float]
) -> str | None:
    """Hold neighbouring exposures of a bracket against each other.

    Args:
        images: linear, of the white level. [H, W, C] each
        saturated: clipped. [H, W] each
        seconds: of each.

    Returns:
        What does not fit, in words with the remedy; None where nothing is clearly wrong.
    """
    order = np.argsort(seconds, kind="stable")
    levels: list[tuple[float, float]] = []
    for short, long in pairwise(order):
        ratio = seconds[long] / seconds[short]
        found = _line(images[short], images[long], saturated[short] | saturated[long], ratio) if ratio > 1.2 else None
        if found is None:
            continue
        (offset, offset_error), (slope, slope_error) = found
        if abs(slope) > LEAST_RATIO + SIGMAS * slope_error:
            times = f"of {seconds[short]:g} and {seconds[long]:g} (ratio {ratio:.3g})"
            return (
                f"the exposures {times} differ by a factor of {ratio * (1 + slope / 2) / (1 - slope / 2):.3g} in the pictures: "
                "check radiometry.exposure_s, or the times and stops in the names"
            )
        levels.append((offset / (1 - ratio), offset_error / (ratio - 1)))
    if not levels:
        return None
    weight = np.array([1 / max(error, 1e-6) ** 2 for _, error in levels])
    level = float(np.average([value for value, _ in levels], weights=weight))
    error = float(1 / np.sqrt(weight.sum()))
    scatter = float(np.ptp([value for value, _ in levels]))
    if abs(level) < max(LEAST_LEVEL, SIGMAS * error, scatter):
        return None
    more = "more" if level > 0 else "less"
    return (
        f"every exposure of the bracket holds {abs(level):.4f} of the white level {more} than its time accounts for: check "
        "radiometry.black_level"
    )


def _line(
    short: NDArray[np.float32], long: NDArray[np.float32], clipped: NDArray[np.bool_], ratio: float
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Offset and slope, with errors, of what the long exposure holds above `ratio` times the short one, over their mean."""
    step = max(1, short.size // SAMPLES)
    rows = np.nonzero(~clipped.ravel())[0][::step]
    x = short.reshape(-1, short.shape[-1])[rows].mean(-1, dtype=np.float64) * ratio
    y = long.reshape(-1, long.shape[-1])[rows].mean(-1, dtype=np.float64)
    use = np.isfinite(x) & np.isfinite(y) & (x > DARKEST * ratio)
    mean, above = (x[use] + y[use]) / 2, (y - x)[use]
    if len(mean) < 50 * PARTS:
        return None
    low, high = np.percentile(mean, [5, 95])
    if high < SPREAD * low:
        return None
    fits = np.array(
        [np.polyfit(m, a, 1) for m, a in zip(np.array_split(mean, PARTS), np.array_split(above, PARTS)) if np.ptp(m) > 0]
    )
    slope, offset = np.polyfit(mean, above, 1)
    if len(fits) < PARTS / 2:
        return None
    slope_error, offset_error = fits.std(0, ddof=1) / np.sqrt(len(fits))
    return (float(offset), float(offset_error)), (float(slope), float(slope_error))
