"""Do the two passes belong together? Light behind parallel polarisers is the crossed light and the specular besides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EXCHANGED = 0.98
"""Mean of the parallel pass over the crossed one below which no polarisers explain it: 1 is no specular light at all, and the
mean over lights and pixels has no noise to speak of."""
EQUAL = 1e-3  # of the crossed light, mean difference of the samples: half floats are half as coarse
STRANGE = 0.05
"""Of the crossed light, what the parallel pass lacks light by light (means over the pixels, so that noise is gone): lamps that
flicker make a percent or two."""
UNEVEN = 1.15
"""Parallel over crossed light where that is least, from which the passes differ in exposure: away from highlights both hold
half of the diffuse light, and filters of one kind differ by a few percent."""
LIT = 0.3  # of a pixel's brightest crossed sample: above it that is no noise
STEADY = 1.04  # third decile of the ratio over the first: one exposure is one factor, highlights are not
CONSTANT = 0.02  # spread of a pixel's samples over their mean below which no light changes it


@dataclass(frozen=True)
class Passes:
    """Figures of two passes: parallel over crossed light; difference of the samples, and light that is missing from the
    parallel pass, as it is and with its lights in the reverse order, over the crossed light; share of pixels without change;
    parallel over crossed light away from highlights (1 where that is no single factor)."""

    ratio: float
    difference: float
    missing: float
    missing_reversed: float
    constant: float
    floor: float = 1.0


def compare(cross: NDArray[np.float32], parallel: NDArray[np.float32]) -> Passes:
    """Figures of samples cross, parallel [N, P] (finite, mean over the colours)."""
    total = float(np.abs(cross).sum()) or 1.0
    c, p = cross.mean(1), parallel.mean(1)
    level = float(np.abs(c).sum()) or 1.0

    def missing(other: NDArray) -> float:
        return float(np.maximum(c - other, 0).sum() / level)

    steady = [x.std(0) < CONSTANT * np.abs(x.mean(0)) for x in (cross, parallel)]
    return Passes(
        float(p.sum() / level), float(np.abs(parallel - cross).sum() / total), missing(p), missing(p[::-1]),
        float(np.mean(steady[0] & steady[1])), _floor(cross, parallel),
    )  # fmt: skip


def _floor(cross: NDArray[np.float32], parallel: NDArray[np.float32]) -> float:
    lit = (cross > LIT * cross.max(0)) & (cross > 0)
    if not lit.any():
        return 1.0
    low, middle = np.percentile(parallel[lit] / cross[lit], (10, 30))
    return float(middle) if low > 0 and middle < STEADY * low else 1.0


def pass_faults(found: Passes, alone: bool = False) -> tuple[str | None, str | None]:
    """(a fault that makes every map wrong with its remedy, a doubt with its remedy); None where there is none.

    alone: there is one pass, given as both.
    """
    if found.constant > 0.9:
        return "no light changes the frames: all of a pass are alike; export one frame for each light", None
    if alone:
        return None, None
    if found.ratio < EXCHANGED:
        if found.missing_reversed < STRANGE < found.missing:
            return None, _order(" in the reverse order")
        return (
            f"the crossed pass is brighter than the parallel one ({1 / max(found.ratio, 1e-6):.2f} times), which no surface "
            "makes: exchange the folders cross and parallel, or give both passes one exposure"
        ), None
    if found.difference < EQUAL:
        return None, (
            "the crossed and the parallel pass are equal: unpolarised frames given as both? Highlights are then taken for "
            "diffuse light, and there is no specular map; photograph both passes behind polarisers for one"
        )
    if found.floor > UNEVEN:
        return None, (
            f"the parallel pass is {found.floor:.2f} times the crossed one even away from highlights, where both hold half of "
            "the diffuse light: were they exposed alike? Give both one exposure (radiometry.exposure_s), or specular maps hold "
            "diffuse light"
        )
    if found.missing > STRANGE:
        return None, _order(" in the reverse order" if found.missing_reversed < 0.5 * found.missing else "")
    return None, None


def _order(how: str) -> str:
    return (
        f"the parallel pass is darker than the crossed one under some lights: is one pass{how or ' in another order'}, or an "
        "exposure changed? Frame k of both must show the same light"
    )
