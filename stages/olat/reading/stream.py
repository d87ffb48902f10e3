"""Frames of all cameras, one band after the other, read by threads of their own: already while the rest is loaded."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pipeline.engine.stage import StageRun
from stages.olat.reading.frame_reader import READERS, Samples, ahead, read_band
from stages.olat.reading.misregistration import WARN_PX, Misregistration, measure
from stages.olat.reading.movement import movement_between
from stages.olat.reading.rig_cameras import CameraJob, camera_jobs, middle_chunk
from stages.olat.reading.scanline_bands import Band, Turn

SWITCH_S = 5e-4  # how long a reader waits for the interpreter while modules load (Python's own 5 ms would starve the readers)


class Undone(NamedTuple):
    """How the parallel pass lay off the crossed one: px right and down, and turned."""

    right: float = 0.0
    down: float = 0.0
    turn: Turn | None = None


NOTHING = Undone()


@dataclass
class Piece:
    """A band of a camera, or pixels of it to choose the lobe on.

    undone: how the parallel pass lay off the crossed one; misregistration: what is left of it, in all bands so far.
    """

    job: CameraJob
    samples: Samples
    undone: Undone
    misregistration: Misregistration
    pilot: bool = False


@dataclass
class Lanes:
    """Cameras that are fitted side by side, each lane's one after the other: their jobs, and what is read of them."""

    jobs: list[list[CameraJob]]
    pieces: list[Iterator[Piece]]


@contextmanager
def reading(stage: StageRun) -> Iterator[Lanes]:
    """Begin to read. The first lane begins with a piece for its pilot where it has several bands. Raises UserError."""
    jobs = camera_jobs(stage)
    count = max(1, min(stage.jobs, len(jobs)))
    lanes = [jobs[k::count] for k in range(count)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    pieces = [ahead(_pieces(stage, lane, k == 0)) for k, lane in enumerate(lanes)]
    try:
        yield Lanes(lanes, list(pieces))
    finally:
        sys.setswitchinterval(interval)
        for lane in pieces:
            lane.close()


def _pieces(stage: StageRun, jobs: list[CameraJob], pilot: bool) -> Iterator[Piece]:
    align = stage.parameters.align
    with ThreadPoolExecutor(READERS) as pool:
        for job in jobs:
            whole = len(job.bands) == 1  # then its shift is measured on what is read anyway
            undone = _measured(job, stage.parameters.band_mb) if align and not whole else NOTHING
            misregistration = Misregistration(job.camera.width, job.camera.height)
            if pilot and job is jobs[0] and not whole:
                yield Piece(job, _band(pool, job, middle_chunk(job), undone), undone, misregistration, pilot=True)
            for band in job.bands:
                samples = _band(pool, job, band, undone)
                misregistration.add(samples)
                if align and whole and (undone := _found(misregistration)) != NOTHING:
                    samples = _band(pool, job, band, undone)
                    misregistration.add(samples)
                yield Piece(job, samples, undone, misregistration)


def _band(pool: ThreadPoolExecutor, job: CameraJob, band: Band, undone: Undone) -> Samples:
    size = (job.camera.width, job.camera.height)
    return read_band(pool, READERS, job.cross, job.parallel, band, size, job.half, (undone.right, undone.down), undone.turn)


def _measured(job: CameraJob, band_mb: float) -> Undone:
    return _found(measure(job.cross, job.parallel, job.mask, job.half, band_mb))


def _found(passes: Misregistration) -> Undone:
    """What is to be undone: a turn with its shift where there clearly is one that matters, else a shift in whole pixels."""
    inside = passes.means[0] > 0
    movement = movement_between(*passes.means, inside, passes.step)
    if movement is not None and movement.turned and movement.furthest_px - np.hypot(movement.right, movement.down) > WARN_PX:
        rows, columns = np.nonzero(inside)
        about = Turn(-float(np.radians(movement.turn_deg)), passes.step * columns.mean(), passes.step * rows.mean())
        return Undone(movement.right, movement.down, about)
    right, down = passes.shift()
    return Undone(round(right), round(down))
