"""What changes over a run, as functions of the fraction done (0..1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Phase:
    """Settings of one step: image pyramid level (0 = full size), learning-rate factors by tensor name ("" = others),
    diffusion factor of the updates, and whether validation views are trained on too."""

    level: int
    rates: dict[str, float]
    diffusion: float
    every_view: bool


def cosine(start: float, end: float, t: float) -> float:
    """Cosine ramp from `start` at t = 0 to `end` at t = 1."""
    return end + (start - end) * 0.5 * (1 + math.cos(math.pi * min(max(t, 0.0), 1.0)))


def phase_at(done: float, coarse: float, consolidate: float) -> Phase:
    """The phase at a fraction `done` of the run."""
    decay = cosine(1.0, 0.03, done)
    warm = min(1.0, done / 0.02 + 0.1)
    return Phase(
        level=1 if done < coarse else 0,
        rates={"": decay * warm, "environment": cosine(1.0, 0.1, done)},
        diffusion=max(0.0, 1 - done / 0.7),
        every_view=done >= 1 - consolidate,
    )


def epoch_order(seed: int, epoch: int, count: int) -> np.ndarray:
    """Permutation of the views for an epoch: depends on seed and epoch alone, so a resumed run sees the same views."""
    return np.random.default_rng([seed, epoch]).permutation(count)
