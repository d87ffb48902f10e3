"""What the command does with a dataset that has a past: what it remembers, says, keeps and refuses."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest


def in_use(dataset: Path) -> dict[str, str]:
    return {p.parent.name: os.readlink(p) for p in dataset.glob("*/current")}


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """Another capture, of the same kind."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "number.txt").write_text("4")
    return tmp_path / "elsewhere"


@pytest.fixture
def dusk(tmp_path: Path) -> Path:
    path = tmp_path / "dusk map.hdr"
    path.write_text("light")
    return path


# -- what is remembered ------------------------------------------------------------------------------------------------


def test_a_single_stage_keeps_the_parameters_that_the_others_were_made_with(command, capture):
    command("all", capture.root, "--dataset", "d", "--params", "count.factor=3")
    assert command("double", "--dataset", "d").ran == []
    assert command("metrics", "--dataset", "d").ran == []
    assert Path("d/double/current/double.txt").read_text() == "126"
    assert command("double", "--dataset", "d", "--params", "count.factor=5").ran == ["count", "double"]
    assert command("double", "--dataset", "d").ran == []


def test_a_stages_own_command_takes_exactly_what_it_is_given(command, capture):
    command("all", capture.root, "--dataset", "d", "--params", "count.factor=3")
    again = command("count", "--dataset", "d")
    assert again.ran == ["count"] and "factor was 3 and is 2" in again.err
    assert 'PARAMS="count.factor=3"' in again.err


def test_all_takes_exactly_what_it_is_given_and_tells_what_differs(command, capture):
    command("all", capture.root, "--dataset", "d", "--params", "count.factor=3")
    again = command("all", "--dataset", "d")
    assert again.ran == ["count", "double", "relight", "metrics"]
    assert "count: made again (factor was 3 and is 2)" in again.err
    assert 'PARAMS="count.factor=3"' in again.err
    assert "double: made again" not in again.err  # it follows: one line for one cause
    back = command("all", "--dataset", "d", "--params", "count.factor=3")
    assert back.ran == [] and "count: an earlier version is put to use (factor was 2 and is 3)" in back.err


def test_maps_are_remembered_where_a_call_is_not_about_relighting(command, capture, dusk):
    command("all", capture.root, "--dataset", "d", "--envs", f"'{dusk}'")
    assert Path("d/relight/current/lit.txt").read_text() == "dusk map"
    assert command("metrics", "--dataset", "d").ran == []
    assert command("report", "--dataset", "d").ran == []
    without = command("relight", "--dataset", "d")
    assert without.ran == ["relight"] and "dusk map.hdr is no longer given" in without.err and "ENVS=" in without.err


def test_a_killed_run_with_parameters_can_be_told_to_a_later_call_without(command, capture):
    command("count", capture.root, "--dataset", "d", "--params", "count.factor=3")
    assert 'PARAMS="count.factor=3"' in command("all", "--dataset", "d").err
    assert "PARAMS" not in command("all", "--dataset", "d").text


def test_a_remembered_parameter_that_no_longer_exists_is_forgotten(command, capture):
    command("all", capture.root, "--dataset", "d")
    description = json.loads(Path("d/dataset.json").read_text())
    description["given"] = {"parameters": {"count": {"gone": "1"}, "nostage": {"x": "1"}}, "environments": ["../gone.hdr"]}
    Path("d/dataset.json").write_text(json.dumps(description))
    assert command("double", "--dataset", "d").status == 0


def test_a_finished_dataset_says_only_that_nothing_is_to_be_done(command, capture):
    command("all", capture.root, "--dataset", "d", "--params", "count.factor=3")
    again = command("all", "--dataset", "d", "--params", "count.factor=3")
    assert again.err == "" and again.out.splitlines() == [
        "d: up to date, nothing to do",
        "report: d/metrics/current/report.html",
    ]


# -- report, plan ------------------------------------------------------------------------------------------------------


def test_report_keeps_what_is_in_use_and_runs_no_other_stage(command, refused, capture):
    command("all", capture.root, "--dataset", "d", "--params", "count.factor=3 metrics.width=12")
    before = in_use(Path("d"))
    assert command("report", "--dataset", "d").ran == [] and in_use(Path("d")) == before
    line = refused("report", "--dataset", "d", "--params", "count.factor=4")
    assert "factor was 3 and is 4" in line and "make metrics" in line and "report.html" in line
    assert in_use(Path("d")) == before
    wide = command("report", "--dataset", "d", "--params", "metrics.width=20")
    assert wide.ran == ["metrics"] and "report: d/metrics/current/report.html" in wide.out
    (capture.root / "number.txt").write_text("5")
    assert "number.txt has changed" in refused("report", "--dataset", "d")


def test_report_of_nothing_says_so_and_makes_nothing(refused, capture):
    assert "no results" in refused("report", capture.root, "--dataset", "d")
    assert not Path("d").exists()


def test_plan_tells_what_is_done_what_will_run_and_why_and_changes_nothing(command, capture):
    fresh = command("plan", capture.root, "--dataset", "d")
    assert "to do: count, double, relight, metrics" in fresh.out and not Path("d").exists()
    command("double", capture.root, "--dataset", "d")
    half = command("plan", "--dataset", "d").out
    assert "done    count" in half and "took 0." in half and "run     relight" in half
    command("all", "--dataset", "d")
    before = in_use(Path("d"))
    assert "all is done" in command("plan", "--dataset", "d").out
    changed = command("plan", "--dataset", "d", "--params", "count.factor=7").out
    assert "redo: factor was 2 and is 7, took 0." in changed and "redo: follows count" in changed
    assert in_use(Path("d")) == before
    command("all", "--dataset", "d", "--params", "count.factor=7")
    back = command("plan", "--dataset", "d").out
    assert "an earlier version (factor was 7 and is 2)" in back and 'PARAMS="count.factor=7"' in back


def test_plan_tells_of_a_killed_stage_that_resumes(command, capture):
    command("plan", capture.root, "--dataset", "d")
    command("count", capture.root, "--dataset", "d")
    key = os.readlink("d/count/current")
    shutil.rmtree(f"d/count/{key}")
    work = Path(f"d/.work/count/{key}")
    (work / "scratch").mkdir(parents=True)
    (work / "scratch" / "checkpoint").write_text("half")
    (work / "usage.json").write_text('{"wall_s": 75}')
    assert "after 1 min 15 s of work" in command("plan", "--dataset", "d").out


def test_a_single_stage_tells_its_folder_and_which_later_stages_are_now_out_of_date(command, capture):
    command("all", capture.root, "--dataset", "d")
    changed = command("count", "--dataset", "d", "--factor", "6")
    assert "count: d/count/current" in changed.out
    assert "out of date: double, relight, metrics" in changed.out and "make metrics" in changed.out
    assert "out of date" not in command("metrics", "--dataset", "d").out
    assert Path("d/double/current/double.txt").read_text() == "252"  # brought up to date with what the stage was given


# -- whose dataset -----------------------------------------------------------------------------------------------------


def test_a_dataset_of_another_capture_is_refused(command, refused, capture, other):
    command("all", capture.root, "--dataset", "d")
    before = in_use(Path("d"))
    for name in ("all", "plan", "report", "count"):
        line = refused(name, other, "--dataset", "d")
        assert "another capture" in line and str(capture.root) in line and "DATASET=" in line
    assert in_use(Path("d")) == before


def test_a_capture_that_was_moved_or_changed_in_place_is_still_the_datasets(command, refused, capture, tmp_path):
    command("all", capture.root, "--dataset", "d")
    capture.root.rename(tmp_path / "renamed")
    assert "CAPTURE=" in refused("plan", "--dataset", "d")
    assert command("all", tmp_path / "renamed", "--dataset", "d").ran == []
    (tmp_path / "renamed" / "number.txt").write_text("8")
    assert "number.txt has changed" in command("all", "--dataset", "d").err


def test_capture_and_dataset_mixed_up_are_told_apart(command, refused, capture, other):
    command("all", capture.root, "--dataset", "d")
    before = sorted(capture.root.rglob("*"))
    assert "is a dataset, not a capture" in refused("all", "d")
    assert "give DATASET=d" in refused("verify", "d")  # a call that reads no capture takes it as one all the same
    assert "is a capture, not a dataset" in refused("all", "--dataset", capture.root)
    assert "is a capture, not a dataset" in refused("all", capture.root, "--dataset", other)
    assert "the capture itself" in refused("all", capture.root, "--dataset", capture.root)
    assert "inside the capture" in refused("all", capture.root, "--dataset", capture.root / "out")
    assert sorted(capture.root.rglob("*")) == before


# -- gc ----------------------------------------------------------------------------------------------------------------


def test_collection_keeps_what_results_in_use_were_made_from_and_can_be_tried_dry(command, capture):
    command("all", capture.root, "--dataset", "d")
    command("count", "--dataset", "d", "--factor", "6")
    kept = in_use(Path("d"))
    first = json.loads(Path("d/double/current/manifest.json").read_text())["inputs"]["stages"]["count"]
    assert first != kept["count"]
    assert "nothing to remove" in command("gc", "--dataset", "d").out
    assert Path(f"d/count/{first}/count.txt").exists()  # double in use was made from it
    command("metrics", "--dataset", "d")
    dry = command("gc", "--dataset", "d", "--dry-run").out
    assert f"would remove d/count/{first}" in dry and "MB" in dry and Path(f"d/count/{first}").exists()
    assert "4 folders" in command("gc", "--dataset", "d", "--yes").out
    assert not Path(f"d/count/{first}").exists() and in_use(Path("d")).keys() == kept.keys()
    assert command("all", "--dataset", "d", "--params", "count.factor=6").ran == []


def test_collection_touches_nothing_that_is_not_a_version(command, capture):
    command("all", capture.root, "--dataset", "d")
    Path("d/notes/count").mkdir(parents=True)
    Path("d/count/mine").mkdir()
    command("gc", "--dataset", "d")
    assert Path("d/notes/count").exists() and Path("d/count/mine").exists()


def test_collection_asks_on_a_terminal(command, capture, monkeypatch):
    command("all", capture.root, "--dataset", "d")
    command("all", "--dataset", "d", "--params", "count.factor=6")
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    for answer, word in (("", "nothing was removed"), ("y", "can go")):
        monkeypatch.setattr("builtins.input", lambda prompt, answer=answer: answer)
        assert word in command("gc", "--dataset", "d").out
    assert len(list(Path("d/count").iterdir())) == 2  # the version in use and its link


def test_collection_waits_for_no_run_but_refuses(command, refused, capture):
    from pipeline.engine.dataset import Dataset

    command("all", capture.root, "--dataset", "d")
    with Dataset(Path("d")).in_use():
        assert "another run" in refused("gc", "--dataset", "d")


def test_collection_of_a_folder_that_is_no_dataset_is_refused(refused, capture, other):
    assert "not a dataset" in refused("gc", "--dataset", other)
    assert (other / "number.txt").exists()


# -- options -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("COMMAND", "all")),
        (("doubel",), ("doubel", "did you mean double?")),
        (("all", "CAPTURE", "--device", "gpu"), ("DEVICE", "'gpu'", "did you mean cuda?")),
        (("all", "CAPTURE", "--device", "cup"), ("DEVICE", "'cup'", "did you mean cpu?")),
        (("all", "CAPTURE", "--jobs", "x"), ("JOBS", "'x'", "whole number")),
        (("all", "CAPTURE", "--jobs", "0"), ("JOBS", "0", "whole number")),
        (("count", "CAPTURE", "--facter", "2"), ("--facter", "did you mean --factor?")),
        (("all", "CAPTURE", "--factor", "2"), ("--factor", "count", "count.factor=VALUE")),
        (("all", "CAPTURE", "--quite"), ("--quite", "did you mean --quiet?")),
        (("count", "CAPTURE", "--fac", "2"), ("--fac", "did you mean --factor?")),
        (("gc", "CAPTURE", "--y"), ("--y", "no such option")),
        (("all", "CAPTURE", "second"), ("second", "quote")),
        (("all", "CAPTURE", "--params"), ("PARAMS", "argument")),
        (("all", "CAPTURE", "--params", "cuont.factor=2"), ("PARAMS", "cuont", "did you mean count?")),
        (("all", "CAPTURE", "--params", "count.facter=2"), ("PARAMS", "facter", "did you mean factor?")),
        (("all", "CAPTURE", "--params", "'"), ("PARAMS", "quot")),
    ],
)
def test_a_mistyped_argument_is_one_line_with_the_nearest_valid_name(refused, capture, arguments, words):
    line = refused(*(capture.root if a == "CAPTURE" else a for a in arguments))
    for word in words:
        assert word in line
    assert "usage:" not in line


def test_a_gpu_that_is_not_there_is_reported_before_anything_runs(command, refused, capture, stages, monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    from pipeline.engine import cli

    house = cli.load_stages({})
    import dataclasses

    house["double"] = dataclasses.replace(house["double"], device=True)
    line = refused("all", capture.root, "--dataset", "d", "--device", "cuda")
    assert "DEVICE" in line and "GPU" in line and "cpu" in line
    assert command("count", capture.root, "--dataset", "d", "--device", "cuda").status == 0


def test_a_capture_that_changes_during_the_run_is_reported_and_the_same_command_goes_on(command, capture, monkeypatch):
    from pipeline.engine import cli

    make = cli.run_stage

    def meanwhile(call, name):
        (capture.root / "number.txt").write_text("7")
        return make(call, name)

    with monkeypatch.context() as patch:
        patch.setattr(cli, "run_stage", meanwhile)
        changed = command("all", capture.root, "--dataset", "d")
    assert changed.status == 2 and "changed during the run" in changed.err
    assert command("all", capture.root, "--dataset", "d").status == 0
    assert Path("d/double/current/double.txt").read_text() == "28"
