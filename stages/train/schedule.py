"""What changes over a run, as functions of the fraction done (0..1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .parameters import FEWER_NUMBERS
from .splats.optimiser import StepRule

# Learning rates at the start, and rounds of diffusion of the updates over the surface graph. Positions are in units of the
# object's half-size and move as one piece; colours and material hardly diffuse: neighbours may differ. With a third of these a
# run needs almost twice the steps to the same error; with four thirds it ends no better.
STEP_RULES = {
    "position": StepRule(1.2e-3, 6),
    "normal": StepRule(2.4e-2, 4),
    "log_scale": StepRule(1.2e-2),
    "opacity": StepRule(6e-2),
    "albedo": StepRule(6e-2, 1),
    "roughness_offset": StepRule(1.2e-2, 2),
    "ior_offset": StepRule(6e-3, 2),
    "roughness": StepRule(3e-2),
    "ior": StepRule(3e-2),
    "indirect": StepRule(1e-2),
    "environment": StepRule(1.2e-1),
    "angles": StepRule(6e-2),
}
LAST_RATE = 0.03  # learning rates at the end, of those at the start: the last steps average over views
LAST_ENVIRONMENT_RATE = 0.1  # the same of the environment, which few pixels of each view tell about
WARM_UP, FIRST_RATE = 0.02, 0.1  # share of the run over which rates rise to theirs, and where from: Adam's moments are young
AGREE_FROM, AGREEMENT = 0.8, 3.0  # share of the run from which normals must agree with positions so many times as much: then
# both are nearly right and tell of each other
DIFFUSE_UNTIL = 0.7  # share of the run after which updates are no longer diffused, so that detail is free to settle


def step_rules(mode: str) -> dict[str, StepRule]:
    """How each tensor is stepped in data of a mode ("stokes", "polarisers", "none")."""
    if mode == "stokes":
        return STEP_RULES
    return {name: StepRule(rule.rate / FEWER_NUMBERS, rule.diffusion) for name, rule in STEP_RULES.items()}


@dataclass(frozen=True)
class Phase:
    """Settings of one step: image pyramid level (0 = full size), learning-rate factors by tensor name ("" = others),
    diffusion factor of the updates, whether validation views are trained on too, and the factor of the weight of agreement of
    normals with positions."""

    level: int
    rates: dict[str, float]
    diffusion: float
    every_view: bool
    agreement: float


def cosine(start: float, end: float, t: float) -> float:
    """Cosine ramp from `start` at t = 0 to `end` at t = 1."""
    return end + (start - end) * 0.5 * (1 + math.cos(math.pi * min(max(t, 0.0), 1.0)))


def phase_at(done: float, coarse: float, consolidate: float) -> Phase:
    """The phase at a fraction `done` of the run."""
    decay = cosine(1.0, LAST_RATE, done)
    warm = min(1.0, done / WARM_UP + FIRST_RATE)
    return Phase(
        level=1 if done < coarse else 0,
        rates={"": decay * warm, "environment": cosine(1.0, LAST_ENVIRONMENT_RATE, done)},
        diffusion=max(0.0, 1 - done / DIFFUSE_UNTIL),
        every_view=done >= 1 - consolidate,
        agreement=AGREEMENT if done >= AGREE_FROM else 1.0,
    )


def epoch_order(seed: int, epoch: int, count: int) -> np.ndarray:
    """Permutation of the views for an epoch: depends on seed and epoch alone, so a resumed run sees the same views."""
    return np.random.default_rng([seed, epoch]).permutation(count)
