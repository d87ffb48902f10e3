"""The train stage's run: prepare, optimise with checkpoints and validation, write the results."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

# Threads that spin while they wait take the cores from each other as soon as anything else runs (20 times slower,
# measured with two cores and two other processes); torch's OpenMP reads this once, when it is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch

from pipeline.engine.progress import Bar
from pipeline.formats import dataset_files as files
from pipeline.geometry.lens import frames_folder

from . import checkpoint
from .angle_search import search_angles
from .initialise.points import read_points
from .parameters import TrainParameters
from .results import finish_polarisers, openings_share, say_what_is_unexplained, write_results
from .setup import NO_POINTS, Start, prepare_training
from .trainer import Trainer
from .upkeep import CYCLE
from .views.source_views import SourceView, load_sources

if TYPE_CHECKING:
    from pipeline.engine.stage import StageRun

NEW_SHARE = 0.02  # of the newest loss in the log's running means: they look back about 50 steps, an epoch of most captures


@dataclass
class History:
    """What the run remembers beside the model: log rows, wall time of earlier legs, best validation, steps skipped."""

    rows: list[dict[str, float]] = field(default_factory=list)
    wall_s: float = 0.0
    best_db: float = -1e9
    stale: int = 0
    sums: dict[str, float] = field(default_factory=dict)
    stopped_at: int = -1


def train(stage: StageRun) -> None:
    """Fill the stage's folder; resumes from `stage.scratch`. Raises UserError on data that cannot be trained."""
    parameters: TrainParameters = stage.parameters
    torch.manual_seed(parameters.seed)
    torch.set_num_threads(1)  # arrays of 20k rows gain nothing from two threads and lose much to their barriers
    started = time.monotonic()
    inputs = stage.inputs
    sources, mode = load_sources(frames_folder(inputs), inputs["poses"], inputs.get("masks"), parameters.polarisation)
    points = read_points(inputs["poses"] / files.POINTS)
    start = prepare_training(sources, mode, stage.capture.polarisers, stage.capture.up, parameters, stage.device, points)
    tell_start(start, stage)
    find_polarisers(start, sources, stage, points)
    backend = "cuda" if stage.device.startswith("cuda") else "cpu"
    trainer = Trainer(start.scene, start.pyramids, mode, start.frame, parameters, backend)
    history = optimise(trainer, stage, started)
    if trainer.scene.bank is not None:
        finish_polarisers(trainer, stage)
    with torch.no_grad():
        write_results(trainer, start, sources, stage)
        say_what_is_unexplained(trainer, start, sources, stage)
    write_log(stage.output / files.TRAIN_LOG, history.rows)
    stage.note("splats", len(trainer.scene.model))
    stage.note("iterations", trainer.iteration)
    stage.note("hollowed", [round(share, 4) for share in trainer.upkeep.hollowed])
    stage.note("openings", round(openings_share(trainer), 5))
    checkpoint.clear(stage.scratch)


def tell_start(start: Start, stage: StageRun) -> None:
    """What training starts from, for the plan; a warning where everything in the pictures counts as the object."""
    facts = start.facts
    stage.note("start_from_points", {"run": facts.points, "reason": facts.reason})
    if not facts.masked and not facts.points:
        remedy = "make masks (masks.method) or find points (poses.triangulate)"
        stage.warn(f"neither masks nor points: everything in view of half the cameras is taken for the object; {remedy}")


def find_polarisers(start: Start, sources: list[SourceView], stage: StageRun, points: np.ndarray = NO_POINTS) -> None:
    """Start values for polariser angles of which nothing is known (a resumed run has them already)."""
    bank = start.scene.bank
    if bank is None or checkpoint.load(stage.scratch, stage.progress.say) is not None:
        return
    unknown = [name for name, settled in zip(bank.names, bank.settled) if not settled]
    if unknown:
        priors, up = stage.capture.polarisers, stage.capture.up
        for name, angle in search_angles(sources, priors, unknown, up, stage.parameters, stage.progress, points).items():
            bank.set_angle(name, float(np.radians(angle)))


def optimise(trainer: Trainer, stage: StageRun, started: float) -> History:
    """Run the schedule to its end, to the time limit, or until validation stops gaining; then consolidate.

    An interrupt keeps the state of the last CYCLE boundary, from where the next run goes on.
    """
    parameters, history = trainer.parameters, History()
    saved = checkpoint.load(stage.scratch, stage.progress.say)
    if saved is not None:
        trainer.load(saved["trainer"])
        history = History(**saved["history"])
    earlier, last_saved, packed = history.wall_s, time.monotonic(), b""
    with kept_when_interrupted(stage, lambda: packed), stage.progress.bar("training", parameters.iterations, "steps") as bar:
        bar.skip(trainer.iteration)
        while trainer.iteration < parameters.iterations:
            now = time.monotonic()
            history.wall_s = earlier + now - started
            if trainer.iteration % CYCLE == 0:
                packed = checkpoint.pack({"trainer": trainer.state(), "history": vars(history)})
                if now - last_saved > parameters.checkpoint_s:
                    checkpoint.write(stage.scratch, packed)
                    last_saved = now
            advance(trainer, history, bar)
            if should_stop(trainer, history):
                history.stopped_at = trainer.iteration
                trainer.skip_to_consolidation()
                bar.skip(trainer.iteration - history.stopped_at)
        history.wall_s = earlier + time.monotonic() - started
        record(trainer, history, trainer.validate())
    return history


@contextmanager
def kept_when_interrupted(stage: StageRun, packed: Callable[[], bytes]) -> Iterator[None]:
    """Save the last packed state, if there is one, when a signal ends the run."""
    try:
        yield
    except KeyboardInterrupt:
        if packed():
            checkpoint.write(stage.scratch, packed())
        raise


def advance(trainer: Trainer, history: History, bar: Bar) -> None:
    """One step, its losses into the running means, validation when it is due."""
    losses = trainer.step()
    for name, value in losses.items():
        history.sums[name] = (1 - NEW_SHARE) * history.sums.get(name, value) + NEW_SHARE * value
    extra = ""
    if trainer.iteration % trainer.parameters.validate_steps == 0:
        psnr = trainer.validate()
        record(trainer, history, psnr)
        history.stale = 0 if psnr > history.best_db + trainer.parameters.patience_db else history.stale + 1
        history.best_db = max(history.best_db, psnr)
        extra = f"PSNR {psnr:.2f} dB"
    bar.advance(1, extra=extra)


def should_stop(trainer: Trainer, history: History) -> bool:
    """Whether refining further is pointless or out of time (never twice, never while images are still coarse)."""
    p = trainer.parameters
    if history.stopped_at >= 0 or trainer.iteration % CYCLE:
        return False
    phase = trainer.phase(trainer.iteration)
    if p.max_minutes > 0 and history.wall_s > 60 * p.max_minutes * (1 - p.consolidate_fraction):
        return not phase.every_view
    return history.stale >= p.patience and phase.level == 0 and not phase.every_view


def record(trainer: Trainer, history: History, psnr: float) -> None:
    """Append a row to the log."""
    row = {"iteration": trainer.iteration, "wall_s": round(history.wall_s, 2), "psnr_validation": round(psnr, 4)}
    row |= {name: round(value, 7) for name, value in history.sums.items()}
    row |= {"splats": len(trainer.scene.model)}
    history.rows.append(row)


def write_log(path: Path, rows: list[dict[str, float]]) -> None:
    """train_log.csv: iteration, wall_s, losses, validation PSNR."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
