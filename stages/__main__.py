"""The `polarfield` command: the command line of `pipeline`, over these stages."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.changes import State
from pipeline.engine.cli import main as run_command
from pipeline.engine.dataset import Dataset
from pipeline.engine.plan import Step
from pipeline.engine.program import Program
from pipeline.errors import UserError
from stages import FORMATS, STAGES


def inspect(capture: Capture, steps: Sequence[Step], folder: Path, found: Mapping[str, State]) -> Path:
    """Write the inspection page of a capture to `folder`; returns its path. Raises UserError."""
    from pipeline.report.inspect import write_inspection
    from stages.disk_estimate import disk_estimate

    running = {step.stage.name for step in steps if step.decision.run}
    return write_inspection(capture, steps, folder, found, disk_estimate(capture, running))


def look(
    capture: Capture, steps: Sequence[Step], found: Mapping[str, State], megapixels: float
) -> tuple[Sequence[str], UserError | None]:
    """What a run would warn of, and the fault that would end it, found by reading about so many million pixels."""
    from stages.early_look import look as look_at

    return look_at(capture, steps, found, megapixels)


def compare(paths: Sequence[Path], output: Path) -> Path:
    """Write the page that shows results side by side to `output`; returns its path. Raises UserError."""
    from stages.metrics.comparison.page import compare as write_comparison

    return write_comparison(paths, output)


def run_tradeoff(capture: Path, dataset: Path, params: str, envs: str, say: Callable[[str], None]) -> Path:
    """Try a capture with other parameters beside its dataset; returns the page's path. Raises UserError."""
    from stages.metrics.tradeoff.run import run_tradeoff as run

    return run(capture, dataset, params, envs, say)


def export(dataset: Dataset, to: str, output: str) -> Path:
    """Copy results of a dataset in a format of `FORMATS`; returns the folder. Raises UserError."""
    from stages.exporting import export as write_export

    return write_export(dataset, to, output)


PROGRAM = Program(
    STAGES, module="stages", report="metrics", inspect=inspect, compare=compare, tradeoff=run_tradeoff,
    look=look, export=export, formats=FORMATS,
)  # fmt: skip


def main() -> None:
    """Run `polarfield` with the arguments of this process."""
    sys.exit(run_command(PROGRAM, sys.argv[1:]))


def stage_main(name: str) -> None:
    """Run one stage alone, as `python -m stages.NAME`, and exit with its status.

    Args:
        name: the stage's.
    """
    sys.exit(run_command(PROGRAM, [name, *sys.argv[1:]]))


if __name__ == "__main__":
    main()
