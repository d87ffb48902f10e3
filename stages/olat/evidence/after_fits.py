"""What a camera's finished maps say of the capture: how much could be fitted, and how well."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.rig.map_flags import AWAY, BAD_SAMPLES, BLACK, FLAGS, GOOD, NO_LOBE, OUTSIDE, SATURATED, SOUND_FLAGS, TOO_FEW
from stages.olat.pixel_fit.result_layout import FLAG, RESIDUAL

MOST = 0.5  # share of pixels with a flag above which the maps as a whole are in doubt
POOR = 0.4
"""Median misfit of good pixels from which the models do not explain the frames: noise of 3 % leaves up to 0.25 of a dim lobe,
several facets in a pixel 0.12, lights in another order 0.4 to 1."""
BINS = 400
REMEDIES = {
    TOO_FEW: "the highlights fall between the lights or are too narrow for them: check the normals alone, or add lights",
    SATURATED: "what clips tells nothing: check the exposure",
    BLACK: "check that the mask is no larger than the object, and no pass empty",
    NO_LOBE: "check that the parallel pass holds specular light, and the passes are not exchanged, equal, or unpolarised",
    BAD_SAMPLES: "samples are not finite: export the frames again",
    AWAY: "the lights or the cameras are in another frame: check the light table",
    OUTSIDE: "the lights do not surround the object: diffuse maps hold, specular ones are bounds; check the light table",
}


class Verdict:
    """Counts a camera's flags and misfits, part by part."""

    def __init__(self) -> None:
        self.counts = np.zeros(len(FLAGS), int)
        self.misfits = np.zeros(BINS + 1, int)

    def add(self, rows: NDArray[np.float64]) -> None:
        """Take in rows [P, WIDTH]."""
        flag = rows[:, FLAG].astype(int)
        self.counts += np.bincount(flag, minlength=len(FLAGS))
        place = np.minimum(rows[flag == GOOD, RESIDUAL] * (BINS / 2), BINS).astype(int)
        self.misfits += np.bincount(place, minlength=BINS + 1)

    @property
    def misfit(self) -> float:
        """Median misfit of the good pixels, to 0.005."""
        total = self.misfits.sum()
        return float((np.searchsorted(np.cumsum(self.misfits), 0.5 * total) + 0.5) * 2 / BINS) if total else 0.0

    def tell(self, stage: StageRun, camera: str, lobe: bool = True) -> None:
        """Keep the figures, and warn where the maps as a whole are in doubt; lobe: the passes are meant to show one."""
        total = int(self.counts.sum())
        stage.note(f"{camera}.flags", {name: int(n) for name, n in zip(FLAGS, self.counts) if n})
        stage.note(f"{camera}.misfit", round(self.misfit, 3))
        doubtful = np.where(np.isin(np.arange(len(FLAGS)), (GOOD,) if lobe else SOUND_FLAGS), 0, self.counts)
        flagged = int(doubtful.sum())
        if flagged > MOST * total:
            worst = int(np.argmax(doubtful))
            stage.warn(
                f"{camera}: {100 * flagged / total:.0f} % of the pixels have a flag, most of them {worst} ({FLAGS[worst]}, "
                f"{100 * self.counts[worst] / total:.0f} %): {REMEDIES[worst]}"
            )
        if self.misfit > POOR and self.counts[GOOD] > MOST * total:
            stage.warn(
                f"{camera}: half of the good pixels miss their samples by {100 * self.misfit:.0f} % and more: check that the "
                "light table fits the frames (frame, order, brightness), with no other light in them, and the surface reflects"
            )
