"""What the light of the decoded views gives reason to doubt: levels, signs, and polarisation that cannot be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import some
from pipeline.engine.stage import StageRun

MANY_CLIPPED = 0.05
"""Share of all samples that are saturated, from which the exposure is in doubt: highlights and a bright sky take 0.002."""
OTHER_SCALE = 12.0
"""Of the views' typical light, from which one is on a scale of its own: the least slip of formats is 16 (12 bits in 16), and
views of one scene, into the sun and away from it, differ by less in what nine tenths of the picture are darker than."""
FEW, FEWEST_VIEWS = 0.25, 4
"""Share of the views up to which they are the odd ones, and views that tell what is usual."""
FAINT = 1e-18  # of the brightest sample, below which its square is no normal number of single precision (1e-38)
MUCH_BELOW = 0.1
"""Of the light above 0, that below it: noise around a black level of 2 % of the object's light makes 0.03 where nine tenths of
the picture are dark, and colours outside of the primaries go below 0 in one channel, not in their mean."""
LOOKED_AT = 256
"""Pixels a side that settle how much light lies below 0."""


@dataclass
class FrameRecord:
    """What frames.json keeps of one view, and what the user is told."""

    facts: dict[str, Any]
    faults: dict[str, int]
    impossible: int = 0
    negative: int = 0
    pixels: int = 0
    black: bool = False
    peak: float = 0.0
    below_zero: float = 0.0
    bright: float = 0.0
    polarised: bool | None = None
    moved: tuple[float, Path] | None = None


def share_below_zero(light: NDArray[np.float32]) -> float:
    """How much light [H, W, 3] lies below 0, of that above; pixels count by their colours' mean, and large images by a part."""
    mean = _finite_means(light)
    above = float(np.maximum(mean, 0).sum())
    return float(-np.minimum(mean, 0).sum()) / above if above > 0 else 0.0


def bright_light(light: NDArray[np.float32]) -> float:
    """What a tenth of the lit pixels of light [H, W, 3] exceed (the colours' mean; of large images a part); 0 where none is."""
    mean = _finite_means(light)
    lit = mean[mean > 0]
    return float(np.percentile(lit, 90)) if lit.size else 0.0


def _finite_means(light: NDArray[np.float32]) -> NDArray[np.float64]:
    """The colours' means over light [H, W, 3], of large images a part, where they are finite [M]."""
    step = max(1, min(light.shape[:2]) // LOOKED_AT)
    mean = light[::step, ::step].mean(-1, dtype=np.float64)
    return np.asarray(mean[np.isfinite(mean)])


def polarised_at_all(stokes: NDArray[np.float32] | None) -> bool | None:
    """Whether any s1 or s2 of [H, W, 3, 3] is not 0; None where there are none."""
    return None if stokes is None else bool(stokes[:, :, 1:].any())


def doubt_light(stage: StageRun, records: Sequence[FrameRecord]) -> None:
    """One line for each thing that the views' light gives reason to doubt."""
    _doubt_levels(stage, records)
    _doubt_polarisation(stage, records)


def _doubt_levels(stage: StageRun, records: Sequence[FrameRecord]) -> None:
    """Exposures that lose much of the object, light below 0, and units in which single precision loses digits."""
    root, total = stage.capture.root, max(1, sum(r.pixels for r in records))
    share = sum(r.facts["saturated_fraction"] * r.pixels for r in records) / total
    if share > MANY_CLIPPED:
        stage.warn(
            f"{root}: {100 * share:.0f} % of all samples are saturated: nothing is learnt from them; "
            "check whether the pictures are overexposed, or were scaled and cut off"
        )
    below = float(np.median([r.below_zero for r in records])) if records else 0.0
    if below > MUCH_BELOW:
        share = f"{100 * below:.0f} % as much light lies below 0 as above it" if below < 1 else "most light lies below 0"
        stage.warn(
            f"{root}: {share} (median of the views), which no light does: check the export, and black_level and dark_frame in "
            "capture.toml"
        )
    _doubt_scales(stage, records)
    peak = max((r.peak for r in records), default=0.0)
    if 0 < peak < FAINT:
        stage.warn(
            f"{root}: the brightest sample is {peak:.0e}: single precision loses digits of so faint radiance; "
            "check its units, and [stokes] scale in capture.toml"
        )


def _doubt_scales(stage: StageRun, records: Sequence[FrameRecord]) -> None:
    """A few views that are many times as bright as the others, or as dark."""
    lit = [r for r in records if r.bright > 0]
    if len(lit) < FEWEST_VIEWS:
        return
    usual = float(np.median([r.bright for r in lit]))
    odd = [r for r in lit if not usual / OTHER_SCALE < r.bright < usual * OTHER_SCALE]
    if 0 < len(odd) <= FEW * len(lit):
        names = some(f"{Path(r.facts['file']).stem} ({r.bright / usual:.3g} times)" for r in odd)
        stage.warn(
            f"{stage.capture.root}: not as bright as the other views: {names}: check their exposure, and that all files were "
            "exported on one scale (0..1, 0..255, codes)"
        )


def _doubt_polarisation(stage: StageRun, records: Sequence[FrameRecord]) -> None:
    """More polarised light than light, or none at all."""
    root, total = stage.capture.root, max(1, sum(r.pixels for r in records))
    impossible = sum(r.impossible for r in records)
    solved = any(r.facts.get("design") is not None for r in records)
    if impossible > total * 0.01:  # noise alone makes a few; more has a cause that the user can mend
        causes = "radiometry.black_level, and mosaic.order or the stack's angles"
        if not solved:
            causes = "that s1 and s2 are radiance as s0 is, not divided by it, not moved by an offset, no degree and angle"
        stage.warn(f"{root}: DoLP is above 1 in {100 * impossible / total:.1f} % of the pixels: check {causes}")
    if records and all(r.polarised is False for r in records):
        what = "the pictures of all angles are the same" if solved else "s1 and s2 are 0 everywhere"
        stage.warn(f"{root}: no light is polarised ({what}): check the export, and that the filter was turned")
