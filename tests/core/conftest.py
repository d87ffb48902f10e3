"""A pipeline of three tiny stages over a made-up capture: the machinery without any physics."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pytest

from pipeline.capture import Capture
from pipeline.stage import Decision, Stage, StageRun


@dataclass(frozen=True)
class CountParameters:
    factor: int = field(default=2, metadata={"help": "multiplies the count"})
    scale: float = 1.0


@dataclass(frozen=True)
class NoParameters:
    pass


def count(run: StageRun) -> None:
    text = (run.capture.root / "number.txt").read_text()
    (run.output / "count.txt").write_text(str(int(text) * run.parameters.factor))
    run.note("rare", {"run": False, "reason": "nothing rare was seen"})


def double(run: StageRun) -> None:
    (run.output / "double.txt").write_text(str(2 * int((run.inputs["count"] / "count.txt").read_text())))


def always(capture: Capture, parameters: object) -> Decision:
    return Decision(True, "always")


@pytest.fixture
def stages() -> dict[str, Stage]:
    return {
        "count": Stage("count", 1, CountParameters, (), always, count, lambda c: [c.root / "number.txt"]),
        "never": Stage("never", 1, NoParameters, ("count",), lambda c, p: Decision(False, "no need"), double),
        "double": Stage("double", 1, NoParameters, ("count", "never"), always, double),
    }


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    root = tmp_path / "capture"
    root.mkdir()
    (root / "number.txt").write_text("21")
    return Capture(root, "numbers", "multiview", "none")
