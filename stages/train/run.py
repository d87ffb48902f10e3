"""The train stage's run: prepare, optimise with checkpoints and validation, write the results."""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

# Threads that spin while they wait take the cores from each other as soon as anything else runs (20 times slower,
# measured with two cores and two other processes); torch's OpenMP reads this once, when it is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch

from pipeline.formats import dataset_files as files
from pipeline.geometry.lens import frames_folder

from . import checkpoint
from .angle_search import search_angles
from .initialise.points import read_points
from .olat_priors import OlatPriors
from .parameters import TrainParameters
from .setup import NO_POINTS, Start, prepare_training
from .splats.closing import close_holes
from .trainer import Trainer
from .training_loop import optimise
from .use_of_maps import maps_in_training
from .views.olat_maps import read_map_pixels
from .views.source_views import SourceView, load_sources
from .write_results import finish_polarisers, openings_share, say_lost_gradients, say_what_is_unexplained, write_results

if TYPE_CHECKING:
    from pipeline.engine.stage import StageRun


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
    backend = "cpu" if stage.device == "cpu" else "cuda"
    trainer = Trainer(start.scene, start.pyramids, mode, start.frame, parameters, backend, measured(start, stage, backend))
    history = optimise(trainer, stage, started)
    closed = close_holes(trainer.scene.model) if openings_share(trainer) == 0 else 0
    if trainer.scene.bank is not None:
        finish_polarisers(trainer, stage)
    with torch.no_grad():
        write_results(trainer, start, sources, stage)
        say_what_is_unexplained(trainer, start, sources, stage)
        say_lost_gradients(trainer, stage)
    write_log(stage.output / files.TRAIN_LOG, history.rows)
    stage.note("splats", len(trainer.scene.model))
    stage.note("iterations", trainer.iteration)
    stage.note("hollowed", [round(share, 4) for share in trainer.upkeep.hollowed])
    stage.note("holes_closed", closed)
    stage.note("openings", round(openings_share(trainer), 5))
    checkpoint.clear(stage.scratch)


def tell_start(start: Start, stage: StageRun) -> None:
    """What training starts from, for the plan; a warning where everything in the pictures counts as the object."""
    facts = start.facts
    stage.note("start_from_points", {"run": facts.points, "reason": facts.reason})
    if not facts.masked and not facts.points:
        remedy = "make masks (masks.method) or find points (poses.triangulate)"
        stage.warn(f"neither masks nor points: everything in view of half the cameras is taken for the object; {remedy}")


def measured(start: Start, stage: StageRun, backend: str) -> OlatPriors | None:
    """What a light stage beside the views has measured, if it is to be used and shows anything."""
    if "olat" not in stage.inputs or not maps_in_training(stage.capture, stage.parameters.olat_priors).run:
        return None
    cameras = read_map_pixels(stage, start.frame, start.pixel)
    found = {camera.view.name: len(camera.view.pixels) for camera in cameras}
    stage.note("olat_pixels", found)
    return OlatPriors(cameras, backend) if cameras else None


def find_polarisers(start: Start, sources: list[SourceView], stage: StageRun, points: np.ndarray = NO_POINTS) -> None:
    """Start values for polariser angles of which nothing is known (a resumed run has them already)."""
    bank = start.scene.bank
    if bank is None or checkpoint.load(stage.scratch, stage.progress.say, stage.device) is not None:
        return
    unknown = [name for name, settled in zip(bank.names, bank.settled) if not settled]
    if unknown:
        priors, up = stage.capture.polarisers, stage.capture.up
        for name, angle in search_angles(sources, priors, unknown, up, stage.parameters, stage.progress, points).items():
            bank.set_angle(name, float(np.radians(angle)))


def write_log(path: Path, rows: list[dict[str, float]]) -> None:
    """train_log.csv: iteration, wall_s, losses, validation PSNR."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
