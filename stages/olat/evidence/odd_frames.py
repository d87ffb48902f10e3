"""Single lights that do not belong to their frames, and light that is in every frame: what Lambert's law leaves tells both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.olat.evidence.frame_order import FEWEST, LIT, lambert

WRONG = 0.3
"""Relative misfit of a light (median over its lit pixels), from which it is not where the table has it; noise leaves 0.05."""
STANDS_OUT = 4.0
"""Times the typical light's misfit."""
FEW = 0.25
"""Share of the lights up to which they are at fault one by one."""
BEHIND = -0.25
"""Cosine below which a light is surely behind the surface."""
FEWEST_BEHIND = 4
NO_LIGHT = 1e-30
"""By which nothing is divided: far below any radiance of a frame."""
AMBIENT, STEADY = 0.03, 0.35
"""Of a pixel's level, what is there without a light, and its spread over the lights: what bounces comes and goes with them."""


def odd_lights(light: NDArray[np.float64], w: NDArray[np.float64]) -> list[int]:
    """Find lights that do not fit their frames while the others do.

    Args:
        light: matte samples. [N, P]
        w: directions. [N, 3]

    Returns:
        Their numbers; empty where none or many do not fit.
    """
    m, each = lambert(light, w)
    predicted = w @ m.T
    lit = (light > LIT * np.maximum(light.max(0), NO_LIGHT)) & np.isfinite(each)
    misfit = np.full(len(w), np.nan)
    for k in np.nonzero(lit.sum(1) >= FEWEST)[0]:
        seen, told = light[k, lit[k]], predicted[k, lit[k]]
        gain = float(np.median(seen) / np.median(told)) if np.median(told) > 0 else 1.0
        misfit[k] = float(np.median(np.abs(seen - gain * told) / seen))
    if not np.isfinite(misfit).any():
        return []
    odd = np.nonzero(misfit > max(WRONG, STANDS_OUT * float(np.nanmedian(misfit))))[0]
    return odd.tolist() if len(odd) <= FEW * np.isfinite(misfit).sum() else []


def ambient(light: NDArray[np.float64], w: NDArray[np.float64]) -> float:
    """Measure light that is in every frame alike, whichever light is on.

    Args:
        light: matte samples. [N, P]
        w: directions. [N, 3]

    Returns:
        Its median share of what lights make of the pixels; 0 where there is less than `AMBIENT`, or it is not steady.
    """
    m, each = lambert(light - np.minimum(light.min(0), 0), w)
    length = np.linalg.norm(m, axis=1)
    normal = m / np.maximum(length, NO_LIGHT)[:, None]
    behind = (w @ normal.T < BEHIND) & np.isfinite(each)
    enough = behind.sum(0) >= FEWEST_BEHIND
    if enough.sum() < FEWEST:
        return 0.0
    dark = np.where(behind, light, np.nan)[:, enough]
    level, spread = np.nanmean(dark, 0), np.nanstd(dark, 0)
    share = float(np.median(level / np.maximum(length[enough], NO_LIGHT)))
    steady = float(np.median(spread / np.maximum(level, NO_LIGHT)))
    return share if share > AMBIENT and steady < STEADY else 0.0
