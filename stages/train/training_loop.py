"""The training loop: steps with checkpoints, validation and a log, to the schedule's end, a time limit, or no more gain."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pipeline.engine.progress import Bar

from . import checkpoint
from .trainer import Trainer

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


def optimise(trainer: Trainer, stage: StageRun, started: float) -> History:
    """Run the schedule to its end, to the time limit, or until validation stops gaining; then consolidate.

    An interrupt keeps the state of the last multiple of `Upkeep.period`, from where the next run goes on.
    """
    parameters, history = trainer.parameters, History()
    saved = checkpoint.load(stage.scratch, stage.progress.say, stage.device)
    if saved is not None:
        trainer.load(saved["trainer"])
        history = History(**saved["history"])
    earlier, last_saved, packed = history.wall_s, time.monotonic(), b""
    with kept_when_interrupted(stage, lambda: packed), stage.progress.bar("training", parameters.iterations, "steps") as bar:
        bar.skip(trainer.iteration)
        while trainer.iteration < parameters.iterations:
            now = time.monotonic()
            history.wall_s = earlier + now - started
            if trainer.iteration % trainer.upkeep.period == 0:
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
    if history.stopped_at >= 0 or trainer.iteration % trainer.upkeep.period:
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
