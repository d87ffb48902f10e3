"""Which lobe a capture's highlights have: the one that leaves the smallest residual on most of a sample of pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.map_flags import GOOD
from stages.olat.pixel_fit.result_layout import FLAG, RESIDUAL, SIGMA

CANDIDATES = ("ward", "beckmann", "ggx")


@dataclass(frozen=True)
class LobeChoice:
    """The lobe, how many pixels had a say (fitted under every lobe, good under one), and each candidate's share of them."""

    lobe: str
    pixels: int
    shares: dict[str, float]


def choose(found: Mapping[str, NDArray[np.float64]]) -> LobeChoice:
    """The best lobe by rows [P, WIDTH] of the same pixels fitted with each; the first where no pixel tells.

    A lobe that is good must not be kept out because another form, fitted to the same samples, is not determined by them.
    """
    names = list(found)
    sound = np.any([rows[:, FLAG] == GOOD for rows in found.values()], 0)
    sound &= np.all([rows[:, SIGMA] > 0 for rows in found.values()], 0)
    residuals = np.stack([rows[sound, RESIDUAL] for rows in found.values()])
    best = np.bincount(residuals.argmin(0), minlength=len(names)) if sound.any() else np.zeros(len(names), int)
    count = int(sound.sum())
    return LobeChoice(names[int(best.argmax())], count, {n: round(int(k) / max(count, 1), 3) for n, k in zip(names, best)})
