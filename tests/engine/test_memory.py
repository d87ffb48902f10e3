"""Every stage says what memory it needs before it starts, fits into what is given, and is stopped with a line."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import time
from pathlib import Path

import pytest

from pipeline.capture import Capture, ViewSource
from pipeline.engine import call as calls
from pipeline.engine import cli
from pipeline.engine.memory import NEARLY_ALL, allowance, machine_mb
from pipeline.engine.plan import Step, load_stages
from pipeline.engine.stage import Decision
from stages import STAGES

# jax, loaded by another test of the process, warns of forks: what is forked here runs no thread of it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")


@pytest.fixture
def hungry(command, capture):
    """Stages that state 300 MB, and 100 more for each further job."""
    stages = cli.load_stages({})
    for name, stage in stages.items():
        stages[name] = dataclasses.replace(stage, memory=lambda capture, parameters, jobs: 200.0 + 100 * jobs)
    return command


def test_what_a_stage_will_take_is_said_before_it_runs_and_kept_beside_what_it_took(hungry, capture):
    said = hungry("count", capture.root, "--dataset", "d")
    assert "count: running (always; about 300 MB of memory)" in said.err
    manifest = json.loads(Path("d/count/current/manifest.json").read_text())
    assert manifest["expected_rss_mb"] == 300.0 and manifest["peak_rss_mb"] > 0


def test_fewer_jobs_side_by_side_fit_into_less_and_what_does_not_fit_is_refused(hungry, capture):
    assert "about 400 MB" in hungry("count", capture.root, "--dataset", "d", "--jobs", "4", "--memory", "450M").err
    line = hungry("double", capture.root, "--dataset", "d", "--memory", "250M").err
    assert "polarfield: double: needs about 300 MB of memory, and MEMORY (--memory) is 250 MB" in line
    assert not list(Path("d").glob("double/*"))
    wrong = hungry("all", capture.root, "--dataset", "d", "--memory", "lots")
    assert wrong.status == 2 and "'lots' is not an amount of memory" in wrong.err


@pytest.mark.slow
def test_a_stage_that_takes_more_than_it_may_is_stopped_with_one_line_and_goes_on_later(hungry, capture, tmp_path):
    stages = cli.load_stages({})
    whole = stages["count"]

    def greedy(run) -> None:
        held = bytearray(b"x") * (800 << 20)
        time.sleep(20)
        del held

    stages["count"] = dataclasses.replace(whole, run=greedy, memory=lambda capture, parameters, jobs: 100.0)
    pid = os.fork()
    if pid == 0:  # it is ended at once: not in the process of the tests
        sys.stderr = (tmp_path / "said").open("w", buffering=1)
        program = calls.Program({}, "none", "metrics", lambda *a: Path())
        cli.main(program, ["count", str(capture.root), "--dataset", "d", "--memory", "700M"])
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 2
    lines = [line for line in (tmp_path / "said").read_text().splitlines() if line.startswith("polarfield: ")]
    assert len(lines) == 1 and "count: takes more than the 700 MB that MEMORY (--memory) allows it, and was" in lines[0]
    stages["count"] = whole
    assert hungry("count", capture.root, "--dataset", "d").status == 0


def test_without_a_budget_the_limit_is_the_machines(hungry, capture):
    step = Step(cli.load_stages({})["count"], Decision(True, ""), None)
    found = allowance(step, capture, 3, "")
    assert (found.expected_mb, found.jobs, found.given) == (500.0, 3, False)
    assert found.limit_mb == pytest.approx(NEARLY_ALL * machine_mb()) and "this machine" in found.overrun("count")


def test_every_stage_states_more_for_larger_pictures():
    def views(side: int) -> Capture:
        sources = tuple(ViewSource(str(k), (), "a", lambda: None, (side, side)) for k in range(12))
        return Capture(Path("x"), "stokes_transforms", "multiview", "stokes", sources, cameras={})

    for name, stage in load_stages(STAGES).items():
        if name != "olat":
            small, large = (stage.memory(views(side), stage.parameters(), 1) for side in (64, 2048))
            assert 50 < small < 1500 and (large > 1.2 * small or name == "poses"), name
