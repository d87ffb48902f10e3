"""The train stage's run: prepare, optimise with checkpoints and validation, write the results."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

# Threads that spin while they wait take the cores from each other as soon as anything else runs (20 times slower,
# measured with two cores and two other processes); torch's OpenMP reads this once, when it is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch

from pipeline.engine.progress import Bar
from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import write_gbuffer
from pipeline.formats.images import write_exr
from pipeline.geometry.cameras import world_offset
from pipeline.geometry.lens import frame_table, frames_folder
from pipeline.report.explained import FEWEST, doubts, explained

from . import checkpoint, export
from .initialise.points import read_points
from .parameters import TrainParameters
from .render_view import mean_normals
from .setup import NO_POINTS, Start, prepare_training
from .trainer import CYCLE, Trainer
from .views.angle_search import search_angles
from .views.data import SourceView, View, load_sources, prepare

if TYPE_CHECKING:
    from pipeline.engine.stage import StageRun


OTHER_ANGLE_DEG = 10.0  # from a trusted angle: filters are set to a degree, and the model bends what it fits by a few


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
    stage.note("hollowed", [round(share, 4) for share in trainer.hollowed])
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
        history.sums[name] = 0.98 * history.sums.get(name, value) + 0.02 * value
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


def finish_polarisers(trainer: Trainer, stage: StageRun) -> None:
    """Standard deviations at the end, and a warning where the capture cannot determine the Stokes vector."""
    bank = trainer.scene.bank
    assert bank is not None
    for name, fit in trainer.estimate_angles(0).items():
        k = bank.names.index(name)
        bank.std_deg[k] = 0.0 if bank.trusted[k] else float(np.degrees(fit.std))
        if bank.trusted[k]:
            told, found, std = (float(np.degrees(v)) for v in (bank.angles[k].detach(), fit.angle, fit.std))
            apart = abs((found - told + 90) % 180 - 90)
            if apart > max(OTHER_ANGLE_DEG, 4 * std):
                stage.warn(
                    f"polariser {name}: told {told % 180:.0f} degrees, but the pictures fit {found:.0f} ± {std:.0f}: check the "
                    "angle and how it is counted (counter-clockwise from the image's x axis), or find it (trusted = false)"
                )
    reason = bank.undetermined()
    if reason:
        stage.warn(f"the capture does not determine the polarisation: {reason}")


def whole_view(trainer: Trainer, start: Start, source: SourceView) -> tuple[View, Any]:
    """A view with every pixel that the model covers, whatever the masks say, and its rendering."""
    blank = replace(source, mask=np.ones_like(source.mask), valid=np.ones_like(source.valid))
    view = prepare(blank, start.frame, True, str(trainer.scene.model["position"].device))
    return view, trainer.render_whole(view)


def say_what_is_unexplained(trainer: Trainer, start: Start, sources: list[SourceView], stage: StageRun) -> None:
    """Hold the model against the test views; a line with the figure and the view where it is of the wrong kind."""
    noise = {view: facts.get("noise") or 0.0 for view, facts in frame_table(stage.inputs).items()}
    found = {}
    for source in sources:
        if source.split != "test":
            continue
        view = prepare(source, start.frame, False, str(trainer.scene.model["position"].device))
        if len(view.pixels) < FEWEST:
            continue
        rendered = trainer.render_whole(view).stokes
        model, target = rendered[:, 0], view.target[:, 0]
        if trainer.mode == "polarisers" and trainer.scene.bank is not None:
            model, target = trainer.scene.bank.intensity(rendered, view.camera.name), 2 * target
        arrays = None
        if trainer.mode == "stokes":
            arrays = rendered[:, 1:].cpu().numpy(), view.target[:, 1:].cpu().numpy()
        scale = start.frame.exposure * (2.0 if trainer.mode == "polarisers" else 1.0)
        found[source.name] = explained(model.cpu().numpy(), target.cpu().numpy(), arrays, scale * noise.get(source.name, 0.0))
    stage.note(
        "explained", {view: {k: None if v is None else round(v, 4) for k, v in vars(f).items()} for view, f in found.items()}
    )
    for line in doubts(found):
        stage.warn(line)


def openings_share(trainer: Trainer) -> float:
    """Mean share of the object's pixels that look into an opening, over the training views."""
    return float(np.mean([view.openings for view in trainer.pyramids[0]]))


def write_results(trainer: Trainer, start: Start, sources: list[SourceView], stage: StageRun) -> None:
    """Everything that dataset.md lists for this stage, except the log."""
    output, frame = stage.output, start.frame
    (output / files.TESTS).mkdir(parents=True, exist_ok=True)
    (output / files.GBUFFERS).mkdir(parents=True, exist_ok=True)
    openings = openings_share(trainer) > 0
    with stage.progress.bar("writing views", total=len(sources), unit="views") as bar:
        for source in sources:
            view, rendered = whole_view(trainer, start, source)
            channels = export.view_channels(rendered, view, frame)
            write_gbuffer(files.gbuffer(output, source.name), channels)
            if source.split == "test":
                normals = mean_normals(trainer.scene.model.activated(), view, trainer.backend, openings)
                channels = export.with_normals(channels, normals, view, frame)
                write_exr(files.held_back_image(output, source.name), channels)
            bar.advance()
    offset = world_offset(stage.inputs["poses"] / files.CAMERAS)
    export.write_gaussians(output / "gaussians.ply", trainer.scene.model, frame, offset)
    export.write_environment(output / files.ENVIRONMENT, trainer.scene.environment.radiance(), frame)
    export.write_polarisers(output / files.POLARISERS, trainer.scene.bank)
    facts = {
        "up": stage.capture.up,
        "fresnel": trainer.parameters.fresnel,
        "lobe": trainer.parameters.lobe,
        "mirror": trainer.parameters.mirror,
        "environment_resolution": trainer.parameters.environment_resolution,
        "occlusion": bool(trainer.scene.occlusion),
    }
    export.write_lighting(output / files.LIGHTING, frame, facts)
