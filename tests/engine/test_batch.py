"""Many captures in one call: planned together, each on its own, within a budget, resumed, and told of in one table."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from pipeline.engine import cli, memory
from pipeline.engine.batch import side_by_side
from pipeline.engine.batch.captures import places_of
from pipeline.engine.stage import Stage
from pipeline.errors import UserError

# jax, loaded by another test of the process, warns of forks: what is forked here runs no thread of it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")


class Fork:
    """A stage's process without the start of a new interpreter."""

    def __init__(self, command, stdout, **options) -> None:
        self.returncode: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
            os.dup2(stdout.fileno(), 1)
            sys.stdout = sys.stderr = os.fdopen(os.dup(1), "w", buffering=1)
            status = 1
            try:
                status = cli.main(command[0], command[1:])
            finally:
                os._exit(status)

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode

    def poll(self) -> int | None:
        return self.returncode

    def terminate(self) -> None:
        os.kill(self.pid, signal.SIGTERM)


@pytest.fixture
def batch(command, tmp_path, monkeypatch):
    """`polarfield batch` over the folder `captures`, its stages in forks of this process; and how many ran at once."""
    for number in (1, 2, 3):
        (tmp_path / "captures" / f"c{number}").mkdir(parents=True)
        (tmp_path / "captures" / f"c{number}" / "number.txt").write_text(str(number))

    def line(call, name, jobs):
        return [call.program, name, str(call.capture.root), "--alone", "--dataset", str(call.dataset.root),
                f"--params={call.settings.params_text()}", f"--envs={call.settings.envs_text()}"]  # fmt: skip

    monkeypatch.setattr(side_by_side, "stage_command", line)
    monkeypatch.setattr(side_by_side.subprocess, "Popen", Fork)

    def call(*more: object):
        return command("batch", "captures", "--dataset", "out", *more)

    return call


def table() -> dict[str, dict]:
    return {c["name"]: c for c in json.loads(Path("out/batch.json").read_text())["captures"]}


def test_every_capture_gets_its_dataset_and_a_second_call_makes_nothing(batch):
    first = batch("--jobs", "3", "--params", "count.factor=5")
    assert first.status == 0, first.text
    assert [Path(f"out/c{n}/double/current/double.txt").read_text() for n in (1, 2, 3)] == ["10", "20", "30"]
    assert all(c["state"] == "done" and c["stages"]["count"]["made"] for c in table().values())
    assert "3 captures" in Path("out/batch.html").read_text()
    again = batch("--params", "count.factor=5")
    assert again.status == 0 and "3 done, 0 to do (0 stages)" in again.out
    assert not any(c["stages"]["count"]["made"] for c in table().values())


@pytest.mark.slow
def test_a_batch_leaves_the_bytes_and_the_description_of_one_run_after_the_other(batch, command):
    batch("--jobs", "2")
    command("all", "captures/c2", "--dataset", "alone")
    for name in ("in_use.json", "dataset.json"):
        mine, theirs = (json.loads(Path(root, name).read_text()) for root in ("out/c2", "alone"))
        assert {k: v for k, v in mine.items() if k not in ("capture", "seal")} == {
            k: v for k, v in theirs.items() if k not in ("capture", "seal")
        }
    assert command("all", "--dataset", "out/c2").ran == []


@pytest.mark.slow
def test_one_that_fails_and_one_that_is_none_stop_no_other_and_are_told_of(batch, tmp_path):
    (tmp_path / "captures" / "c2" / "number.txt").write_text("no number")
    (tmp_path / "captures" / "c4").mkdir()
    (tmp_path / "captures" / "c4" / "notes.txt").touch()
    done = batch("--jobs", "2")
    assert done.status == 1 and "2 of 4 captures are done" in done.out
    found = table()
    assert [found[f"c{n}"]["state"] for n in (1, 2, 3, 4)] == ["done", "failed", "done", "unreadable"]
    assert found["c2"]["stage"] == "count" and "no known capture layout" in found["c4"]["line"]
    assert "count" in Path("out/.batch/logs/c2/count.log").read_text()
    (tmp_path / "captures" / "c2" / "number.txt").write_text("2")
    batch()
    assert table()["c2"]["state"] == "done"


@pytest.mark.slow
def test_a_stage_that_a_signal_ended_is_tried_again_but_not_for_ever(batch, tmp_path):
    stages = cli.load_stages({})
    whole = stages["double"]

    def killed(run) -> None:
        tries = tmp_path / f"tries-{run.capture.root.name}"
        tries.write_text(tries.read_text() + "." if tries.exists() else ".")
        if run.capture.root.name == "c3" or (run.capture.root.name == "c1" and len(tries.read_text()) < 2):
            os.kill(os.getpid(), signal.SIGKILL)
        whole.run(run)

    stages["double"] = Stage("double", 1, whole.parameters, whole.needs, whole.needed, killed)
    done = batch()
    assert done.status == 1 and "2 of 3 captures are done" in done.out and "trying again (2 of 3)" in done.err
    assert "ended by SIGKILL" in table()["c3"]["line"] and len((tmp_path / "tries-c3").read_text()) == side_by_side.TRIES


@pytest.mark.slow
@pytest.mark.parametrize(("jobs", "budget", "most"), [(3, "1000M", 3), (2, "1000M", 2), (3, "250M", 2), (3, "50M", 1)])
def test_stages_side_by_side_stay_within_jobs_and_memory(batch, monkeypatch, jobs, budget, most):
    stages = cli.load_stages({})
    for name, stage in stages.items():
        stages[name] = dataclasses.replace(stage, memory=lambda capture, parameters, jobs: 100.0)
    seen = []
    start = side_by_side.SideBySide._start

    def counted(self, row, step):
        found = start(self, row, step)
        seen.append(len(self.running))
        return found

    monkeypatch.setattr(side_by_side.SideBySide, "_start", counted)
    assert batch("--jobs", jobs, "--memory", budget).status == 0
    assert max(seen) == most


def test_an_amount_of_memory_is_read_as_people_write_it():
    assert memory.parsed_mb("2G") == 2048 and memory.parsed_mb("1500M") == 1500 and memory.parsed_mb("0.5gb") == 512
    assert 100 < memory.machine_mb() < 1e8
    with pytest.raises(UserError, match="is not an amount of memory"):
        memory.parsed_mb("much")


@pytest.mark.slow
def test_an_interrupt_ends_the_stages_at_work_and_still_writes_the_table(batch, tmp_path):
    stages = cli.load_stages({})
    whole = stages["double"]

    def endless(run) -> None:
        os.kill(os.getppid(), signal.SIGTERM)
        time.sleep(60)

    stages["double"] = dataclasses.replace(whole, run=endless)
    started = time.monotonic()
    done = batch("--jobs", "3")
    assert time.monotonic() - started < 30 and done.status == 128 + signal.SIGTERM
    assert done.err.count("polarfield: interrupted") == 1
    assert {c["state"] for c in table().values()} == {"unfinished"}
    stages["double"] = whole
    assert batch("--jobs", "3").status == 0


def test_a_list_names_captures_by_paths_and_equal_names_are_told_apart(tmp_path):
    for path in ("a/cup", "b/cup", "b/vase"):
        (tmp_path / path).mkdir(parents=True)
        (tmp_path / path / "x.png").touch()
    listed = tmp_path / "list.txt"
    listed.write_text("# the cups\na/cup\n\nb/cup\n  b/vase  \n")
    assert [p.name for p in places_of(listed)] == ["a_cup", "b_cup", "vase"]
    assert [p.name for p in places_of(tmp_path)] == ["a_cup", "b_cup", "vase"]
    listed.write_text("a/cup\na/../a/cup\n")
    with pytest.raises(UserError, match="is named twice"):
        places_of(listed)
    listed.write_text("# none\n")
    with pytest.raises(UserError, match="names no capture"):
        places_of(listed)
    with pytest.raises(UserError, match="no such folder or list"):
        places_of(tmp_path / "gone")


def test_nothing_is_written_behind_links_that_were_left_beside_the_datasets(batch, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (tmp_path / "out" / ".batch" / "logs" / "c1").mkdir(parents=True)
    (tmp_path / "out" / ".batch" / "logs" / "c1" / "count.log").symlink_to(outside / "log")
    (tmp_path / "out" / ".batch" / "logs" / "c2").symlink_to(outside)
    (tmp_path / "out" / "c3").symlink_to(outside)
    assert batch().status == 1 and list(outside.iterdir()) == []
    assert {c["state"] for c in table().values()} <= {"failed", "unreadable"}
    (tmp_path / "out" / ".batch").rename(tmp_path / "aside")
    (tmp_path / "out" / ".batch").symlink_to(outside)
    done = batch()
    assert done.status == 2 and "is a link" in done.err and list(outside.iterdir()) == []


@pytest.mark.parametrize("name", [".batch", "batch.json", "/", "\udcff"])
def test_a_name_that_a_batch_keeps_or_no_file_has_is_refused(tmp_path, name):
    (tmp_path / "list.txt").write_bytes(os.fsencode(name) + b"\n")
    with pytest.raises(UserError):
        places_of(tmp_path / "list.txt")


def test_a_batch_is_not_written_into_a_capture(refused, tmp_path):
    (tmp_path / "captures" / "c1").mkdir(parents=True)
    (tmp_path / "captures" / "c1" / "number.txt").write_text("1")
    assert "lies inside the capture" in refused("batch", "captures", "--dataset", "captures/c1/out")
    assert "no folder of captures was given" in refused("batch")
