"""Which way unknown polarisers stand: short, small trainings from many starts, the worse ones dropped on the way.

The loss has a wrong basin for most starts (the model explains the contrast by bent normals and tinted light), and the
right one differs from it within a hundred steps: its loss is a tenth lower.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.capture.model import PolariserPrior
from pipeline.engine.progress import Progress

from .parameters import TrainParameters
from .scene import Scene
from .setup import NO_POINTS, Start, prepare_training, start_environment
from .splats.gaussians import SplatModel
from .trainer import Trainer
from .views.polarisers import PolariserBank
from .views.source_views import SourceView

SPACING_DEG = 45.0  # between starts: every angle is within 22.5 degrees of one, where cos 2t keeps its sign
MOST_STARTS = 24  # for three polarisers or more, spread at random
ROUNDS = ((60, 5), (80, 2), (100, 1))  # (steps, survivors) of each round
SMALL = {
    "max_splats": 2400,
    "start_fraction": 1.0,
    "coarse_fraction": 1.0,
    "environment_resolution": 16,
    "indirect": "none",
    "mirror": "split",
    "densify": False,
    "concavities": "off",
    "hull_resolution": 56,
    "iterations": 400,
}


@dataclass
class Candidate:
    """One start: angles in degrees by polariser, its trainer, and the mean loss of its latest steps."""

    angles: dict[str, float]
    trainer: Trainer
    loss: float = math.inf


def starts(unknown: Sequence[str], seed: int) -> list[dict[str, float]]:
    """Angles to start from (degrees): the whole grid for one or two polarisers, random ones for more."""
    grid = np.arange(0.0, 180.0, SPACING_DEG)
    if len(unknown) <= 2:
        return [dict(zip(unknown, map(float, combination))) for combination in itertools.product(grid, repeat=len(unknown))]
    rng = np.random.default_rng(seed)
    return [dict(zip(unknown, map(float, rng.uniform(0, 180, len(unknown))))) for _ in range(MOST_STARTS)]


def search_angles(
    sources: list[SourceView],
    priors: Mapping[str, PolariserPrior],
    unknown: Sequence[str],
    up: str,
    parameters: TrainParameters,
    progress: Progress,
    points: np.ndarray = NO_POINTS,
) -> dict[str, float]:
    """Start angles of polarisers of which nothing is known, by short trainings from a grid of angles.

    Args:
        sources: the views, as loaded.
        priors: what is known of each camera's polariser.
        unknown: names of the cameras whose angle is sought.
        up, parameters, points: as in `prepare_training`.
        progress: where the bar is shown.

    Returns:
        Angle by name (degrees, 0..180).
    """
    small = replace(parameters, **SMALL)  # type: ignore[arg-type]
    start = prepare_training(sources, "polarisers", priors, up, small, "cpu", points, cut=False)
    candidates = [Candidate(angles, _trainer(start, priors, angles, small)) for angles in starts(unknown, parameters.seed)]
    total = _total_steps(len(candidates))
    with progress.bar("finding the polarisers", total=total, unit="steps") as bar:
        for steps, survivors in ROUNDS:
            for candidate in candidates:
                recent = [candidate.trainer.step()["rgb"] for _ in range(steps)]
                candidate.loss = float(np.mean(recent[-len(start.pyramids[0]) :]))
                bar.advance(steps)
            candidates = sorted(candidates, key=lambda c: c.loss)[:survivors]
    bank = candidates[0].trainer.scene.bank
    assert bank is not None
    return {name: state.angle_deg for name, state in bank.result().items() if name in unknown}


def _total_steps(count: int) -> int:
    total = 0
    for steps, survivors in ROUNDS:
        total += steps * count
        count = min(count, survivors)
    return total


def _trainer(
    start: Start, priors: Mapping[str, PolariserPrior], angles: Mapping[str, float], parameters: TrainParameters
) -> Trainer:
    scene = start.scene
    assert scene.bank is not None
    bank = PolariserBank(priors, scene.bank.names)
    for name, angle in angles.items():
        bank.set_angle(name, math.radians(angle))
    environment = start_environment(parameters)
    own = Scene(SplatModel(scene.model.tensors), environment, bank, scene.hull)
    return Trainer(own, start.pyramids, "polarisers", start.frame, parameters, "cpu")
