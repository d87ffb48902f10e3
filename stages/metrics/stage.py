"""Metrics: figures of merit against the capture's own test views and its gt/, and the report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.stage import Decision, Stage, StageRun


@dataclass(frozen=True)
class MetricsParameters:
    """What the report shows."""

    mesh_samples: int = field(default=100000, metadata={"help": "points on each surface for the mesh figures (count)"})
    picture_px: int = field(default=288, metadata={"help": "longer side of the report's pictures at most (px)"})
    shown_views: int = field(default=4, metadata={"help": "test views shown in the report at most (count)"})

    def __post_init__(self) -> None:
        if self.mesh_samples < 100:
            raise ValueError("mesh_samples must be at least 100")
        if not 32 <= self.picture_px <= 4096:
            raise ValueError("picture_px must lie between 32 and 4096")
        if self.shown_views < 1:
            raise ValueError("shown_views must be at least 1")


def needed(capture: Capture, parameters: MetricsParameters) -> Decision:
    """Always: costs and pictures are of use without any truth."""
    if any(True for _ in capture_files(capture)):
        return Decision(True, "figures against the test views and the capture's ground truth; the report")
    return Decision(True, "figures against the test views (no ground truth in the capture); the report")


def capture_files(capture: Capture) -> Iterable[Path]:
    """The capture's ground truth."""
    root = capture.root
    loose = [root / "gt_brdf.json", root / "gt_lp.json", *sorted(root.glob("cam[0-9]*/gt/maps.npz"))]
    folder = sorted(p for p in (root / "gt").rglob("*") if p.is_file()) if (root / "gt").is_dir() else []
    return [p for p in loose if p.is_file()] + folder


def run(run: StageRun) -> None:
    """Write metrics.json and report.html."""
    from .run import measure

    measure(run)


STAGE = Stage(
    name="metrics",
    version=2,
    parameters=MetricsParameters,
    needs=("decode", "poses", "masks", "olat", "train", "mesh", "relight"),
    needed=needed,
    run=run,
    capture_files=capture_files,
    config=("up", "olat"),
)
