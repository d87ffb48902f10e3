"""A pipeline of three tiny stages over a made-up capture: the machinery without any physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from pipeline.capture import Capture
from pipeline.engine import call as calls
from pipeline.engine import cli, places
from pipeline.engine.execute import make_version
from pipeline.engine.memory import allowance
from pipeline.engine.stage import Decision, Stage, StageRun
from pipeline.errors import UserError


@dataclass(frozen=True)
class CountParameters:
    factor: int = field(default=2, metadata={"help": "multiplies the count"})
    scale: float = 1.0


@dataclass(frozen=True)
class NoParameters:
    pass


@dataclass(frozen=True)
class ReportParameters:
    width: int = 10


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


@dataclass
class Outcome:
    """What a call of the command left: exit status, what it printed, and the stages that it ran."""

    status: int
    out: str
    err: str
    ran: list[str]

    @property
    def text(self) -> str:
        return self.out + self.err


def relight(run: StageRun) -> None:
    (run.output / "lit.txt").write_text(" ".join(p.stem for p in run.environments))


def report(run: StageRun) -> None:
    (run.output / "report.html").write_text("<html>")


def inspect(capture, steps, folder, found) -> Path:
    folder.mkdir()
    page = folder / "inspect.html"
    page.write_text("<html>")
    return page


PROGRAM = calls.Program({}, module="none", report="metrics", inspect=inspect)


@pytest.fixture
def command(stages, tmp_path, monkeypatch, capsys) -> Callable[..., Outcome]:
    """`polarfield` over stages count, double, train, relight and metrics that cost nothing, run in this process.

    A capture is a folder with number.txt in it.
    """
    house = dict(stages)
    house["relight"] = Stage("relight", 1, NoParameters, ("double",), always, relight, environments=True)
    house["metrics"] = Stage("metrics", 1, ReportParameters, ("count", "double", "relight"), always, report)
    ran: list[str] = []

    def open_capture(path: Path) -> Capture:
        if not (Path(path) / "number.txt").is_file():
            raise UserError(path, "no known capture layout")
        return Capture(Path(path).absolute(), "numbers", "multiview", "none")

    def here(call: calls.Call, name: str) -> int:
        ran.append(name)
        steps = cli.make_plan(
            call.capture, call.stages, call.settings.parameters, call.capture.environments, call.dataset.digests
        )
        step = next(s for s in steps if s.stage.name == name)
        allowed = allowance(step, call.capture, call.options.jobs, call.options.memory)
        make_version(call.dataset, call.capture, step, call.capture.environments, "cpu", allowed, call.progress, steps)
        return 0

    monkeypatch.setattr(cli, "load_stages", lambda modules: house)
    monkeypatch.setattr(cli, "run_stage", here)
    monkeypatch.setattr(places, "open_capture", open_capture)
    monkeypatch.setattr("pipeline.engine.settings.image_size", lambda path: (2, 1))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def call(*arguments: object) -> Outcome:
        ran.clear()
        status = cli.main(PROGRAM, [str(a) for a in arguments])
        printed = capsys.readouterr()
        return Outcome(status, printed.out, printed.err, list(ran))

    return call


@pytest.fixture
def refused(command) -> Callable[..., str]:
    """Run `polarfield` where it must refuse: returns the one line that it says, after checking that it is one."""

    def call(*arguments: object) -> str:
        outcome = command(*arguments)
        assert outcome.status == 2 and not outcome.ran
        assert outcome.err.startswith("polarfield: ") and outcome.err.count("\n") == 1
        assert "Traceback" not in outcome.text
        return outcome.err

    return call
