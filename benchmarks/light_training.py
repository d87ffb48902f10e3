"""What each kind of indirect light adds to training and to the rendering of a test view."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

STEPS, LOOKS, REPEATS = 60, 4, 8
"""Steps over which training is timed, and test views that are rendered, each so often."""


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call returns, and its processor seconds."""
    start = time.process_time()
    value = call()
    return value, time.process_time() - start


def in_turn(calls: Sequence[Callable[[], Any]], count: int) -> NDArray[np.float64]:
    """Processor seconds of each of some calls, made in turn so many times, after twice to warm up [count, calls]."""
    return np.array([[timed(call)[1] for call in calls] for _ in range(count + 2)])[2:]


def training_overhead(folder: Path, scratch: Path) -> dict[str, dict[str, float]]:
    """Processor seconds of a step, of making indirect light anew and of a test view, by kind; shares of those without it.

    Measured on the start surface, at a step after the light was made. `every`: steps between two times of a whole run, in the
    mean.
    """
    from benchmarks.bench_train import sources_of
    from stages.train.parameters import TrainParameters
    from stages.train.setup import prepare_training
    from stages.train.trainer import Trainer
    from stages.train.views.view import prepare

    torch.set_num_threads(1)
    sources, _, up = sources_of(folder, scratch)
    trainers, out = {}, {}
    for kind in ("none", "gridmap", "sh", "traced"):
        parameters = replace(TrainParameters(), indirect=kind, concavities="off")
        start = prepare_training(sources, "stokes", {}, up, parameters, "cpu")
        trainer = trainers[kind] = Trainer(start.scene, start.pyramids, "stokes", start.frame, parameters, "cpu")
        trainer.scene.link_neighbours()
        anew = 0.0
        for _ in range(2 if kind != "none" else 0):  # the first time builds what stays: filters, neighbours
            anew = timed(partial(trainer.renderer.trace, trainer.pyramids[0], 0))[1]
        times = sum(trainer.upkeep.traces_before(step, 0) for step in range(parameters.iterations))
        out[kind] = {"anew_s": anew, "every": parameters.iterations / max(times, 1)}
        trainer.iteration = trainer.upkeep.period + 1
    tests = [replace(s, mask=np.ones_like(s.mask)) for s in sources if s.split == "test"][:LOOKS]
    # In turn, so that what else runs on the machine slows all kinds alike; it only ever adds.
    steps = in_turn([trainer.step for trainer in trainers.values()], STEPS)
    looks = []
    with torch.no_grad():
        for source in tests:
            calls = [partial(t.renderer.render_whole, prepare(source, t.frame, True)) for t in trainers.values()]
            looks.append(in_turn(calls, REPEATS))
    for row, step_s, look_s in zip(out.values(), np.percentile(steps, 10, 0), np.percentile(looks, 10, 1).mean(0)):
        row |= {"step_s": float(step_s), "test_view_s": float(look_s)}
        print("   ", {k: round(v, 4) for k, v in row.items()}, flush=True)
    free = out["none"]
    for row in out.values():
        row["training_pct"] = 100 * ((row["step_s"] + row["anew_s"] / row["every"]) / free["step_s"] - 1)
        row["inference_pct"] = 100 * (row["test_view_s"] / free["test_view_s"] - 1)
    return out
