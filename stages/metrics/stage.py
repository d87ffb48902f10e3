"""Metrics: figures of merit against the capture's own test views and its gt/, and the report."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.stage import Decision, Stage, StageRun
from stages import memory_estimate, time_estimate

from .parameters import MetricsParameters


def needed(capture: Capture, parameters: MetricsParameters) -> Decision:
    """Always: costs and pictures are of use without any truth."""
    if any(True for _ in capture_files(capture)):
        return Decision(True, "figures against the test views and the capture's ground truth; the report")
    return Decision(True, "figures against the test views (no ground truth in the capture); the report")


def capture_files(capture: Capture) -> Iterable[Path]:
    """The capture's ground truth."""
    return capture.truth.files()


def check(capture: Capture) -> None:
    """Raise UserError where the ground truth cannot be used."""
    from .truth_check import check_truth

    check_truth(capture, capture_files(capture))


def run(run: StageRun) -> None:
    """Write metrics.json and report.html."""
    from .run import measure

    measure(run)


STAGE = Stage(
    name="metrics",
    version=5,
    parameters=MetricsParameters,
    needs=("decode", "poses", "masks", "olat", "train", "mesh", "relight"),
    needed=needed,
    run=run,
    capture_files=capture_files,
    check=check,
    config=("up", "olat", "unit_m"),
    memory=memory_estimate.metrics,
    costs=time_estimate.metrics,
)
