"""Frames of all cameras, one band after the other, read by threads of their own: already while the rest is loaded."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

from pipeline.engine.stage import StageRun
from stages.olat.reading.frame_reader import READERS, Samples, ahead, read_band
from stages.olat.reading.misregistration import Misregistration, measure
from stages.olat.reading.rig_cameras import CameraJob, camera_jobs, middle_chunk
from stages.olat.reading.scanline_bands import Band

SWITCH_S = 5e-4  # how long a reader waits for the interpreter while modules load (Python's own 5 ms would starve the readers)


@dataclass
class Piece:
    """A band of a camera, or pixels of it to choose the lobe on.

    shift: of the parallel pass (px right, down), undone; misregistration: what is left of it, in all bands so far.
    """

    job: CameraJob
    samples: Samples
    shift: tuple[int, int]
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
            shift = _measured(job, stage.parameters.band_mb) if align and not whole else (0, 0)
            misregistration = Misregistration(job.camera.width, job.camera.height)
            if pilot and job is jobs[0] and not whole:
                yield Piece(job, _band(pool, job, middle_chunk(job), shift), shift, misregistration, pilot=True)
            for band in job.bands:
                samples = _band(pool, job, band, shift)
                misregistration.add(samples)
                if align and whole and any(shift := _rounded(misregistration.shift())):
                    samples = _band(pool, job, band, shift)
                    misregistration.add(samples)
                yield Piece(job, samples, shift, misregistration)


def _band(pool: ThreadPoolExecutor, job: CameraJob, band: Band, shift: tuple[int, int]) -> Samples:
    size = (job.camera.width, job.camera.height)
    return read_band(pool, READERS, job.cross, job.parallel, band, size, job.half, shift)


def _measured(job: CameraJob, band_mb: float) -> tuple[int, int]:
    return _rounded(measure(job.cross, job.parallel, job.mask, job.half, band_mb))


def _rounded(shift: tuple[float, float]) -> tuple[int, int]:
    """A shift in whole pixels (right, down)."""
    return round(shift[0]), round(shift[1])
