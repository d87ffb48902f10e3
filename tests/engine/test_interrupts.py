"""Signals to the run alone reach the stage, which keeps what it can and ends within seconds, with one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pipeline.formats.images import write_png

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
STAGE = """
import time
from dataclasses import dataclass
from pipeline.engine.stage import Decision, Stage

@dataclass(frozen=True)
class Parameters:
    deaf: bool = False

def run(stage):
    print("begun", flush=True)
    mark = stage.scratch / "checkpoint"
    if mark.exists():
        (stage.output / "out").write_text("resumed")
        return
    try:
        while True:
            if stage.parameters.deaf:
                import signal
                signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # as within a library that takes minutes
            time.sleep(0.01)
    except KeyboardInterrupt:
        mark.write_text("half")
        raise

STAGE = Stage("slow", 1, Parameters, (), lambda c, p: Decision(True, "always"), run)
"""
PROGRAM = """
import sys
from pipeline.engine import call, cli

PROGRAM = call.Program({"slow": "house.slow"}, module="house", report="none", inspect=None)
if __name__ == "__main__":
    sys.exit(cli.main(PROGRAM, sys.argv[1:]))
"""


@pytest.fixture
def begin(tmp_path):
    """Start a run of one stage that never ends by itself, and wait until it is at work."""
    (tmp_path / "house" / "slow").mkdir(parents=True)
    (tmp_path / "house" / "slow" / "__init__.py").touch()
    (tmp_path / "house" / "slow" / "stage.py").write_text(STAGE)
    (tmp_path / "house" / "__main__.py").write_text(PROGRAM)
    for k in range(3):
        write_png(tmp_path / "capture" / "images" / f"{k}.png", np.full((8, 8, 3), 40 * k + 90, np.uint8))
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    line = [sys.executable, "-m", "house", "slow", "capture", "--dataset", "d"]

    def start(*more: str) -> subprocess.Popen[str]:
        run = subprocess.Popen(
            [*line, *more], cwd=tmp_path, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        assert run.stdout is not None and run.stdout.readline() == "begun\n"
        return run

    return start


@pytest.mark.parametrize(("number", "group"), [(signal.SIGINT, False), (signal.SIGTERM, False), (signal.SIGINT, True)])
def test_a_signal_is_passed_on_said_once_and_the_stage_goes_on_from_what_it_kept(begin, tmp_path, number, group):
    run = begin()
    started = time.monotonic()
    (os.killpg if group else os.kill)(run.pid, number)  # of a group: Ctrl-C on a terminal
    _, said = run.communicate(timeout=20)
    assert time.monotonic() - started < 5 and run.returncode == 128 + number
    lines = [line for line in said.splitlines() if "slow: running" not in line]
    assert len(lines) == 1 and lines[0].startswith("polarfield: interrupted; the same command goes on"), said
    assert len(list(tmp_path.glob("d/.work/slow/*/scratch/checkpoint"))) == 1
    again = begin()
    again.communicate(timeout=20)
    assert again.returncode == 0 and (tmp_path / "d/slow/current/out").read_text() == "resumed"


def test_a_stage_that_hears_nothing_is_ended_all_the_same(begin):
    run = begin("--deaf", "true")
    started = time.monotonic()
    run.send_signal(signal.SIGTERM)
    _, said = run.communicate(timeout=20)
    assert time.monotonic() - started < 6 and run.returncode == 143 and said.count("polarfield: interrupted") == 1
