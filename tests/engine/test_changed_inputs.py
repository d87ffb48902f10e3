"""A file that changes while a stage reads it is found before anything is published; killed runs leave nothing behind."""

from __future__ import annotations

import dataclasses
import os
import subprocess
from pathlib import Path

import pytest


@pytest.mark.parametrize("keep_time", [False, True])
def test_a_capture_that_changes_while_a_stage_runs_is_told_and_nothing_is_published(command, capture, stages, keep_time):
    from pipeline.engine import cli

    house = cli.load_stages({})
    number, run = capture.root / "number.txt", stages["count"].run

    def changed_meanwhile(stage):
        stat = number.stat()
        (stage.scratch / "checkpoint").write_text("of both")
        number.write_text("33")  # as long as before
        if keep_time:
            os.utime(number, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        run(stage)

    house["count"] = dataclasses.replace(house["count"], run=changed_meanwhile)
    stopped = command("all", capture.root, "--dataset", "d")
    assert stopped.status == 2 and "number.txt: was changed while count ran" in stopped.err
    assert not list(Path("d").glob("count/*")) and not list(Path("d").glob(".work/count/*/scratch/*"))
    house["count"] = dataclasses.replace(house["count"], run=run)
    os.utime(number)
    assert command("all", "--dataset", "d").status == 0 and Path("d/double/current/double.txt").read_text() == "132"


def test_a_file_that_is_only_touched_while_a_stage_runs_is_no_change(command, capture, stages):
    from pipeline.engine import cli

    house, run = cli.load_stages({}), stages["count"].run
    house["count"] = dataclasses.replace(house["count"], run=lambda s: (os.utime(capture.root / "number.txt"), run(s)))
    assert command("all", capture.root, "--dataset", "d").status == 0


def test_a_stage_that_fails_because_its_file_changed_says_that(command, capture, stages):
    from pipeline.engine import cli

    house = cli.load_stages({})

    def broken_meanwhile(stage):
        (capture.root / "number.txt").unlink()
        raise ValueError("half of it")

    house["count"] = dataclasses.replace(house["count"], run=broken_meanwhile)
    stopped = command("all", capture.root, "--dataset", "d")
    assert stopped.status == 2 and "number.txt" in stopped.err and stopped.err.count("polarfield:") == 1


def test_what_killed_runs_left_is_cleared(command, capture):
    command("all", capture.root, "--dataset", "d")
    key = os.readlink("d/count/current")
    gone = subprocess.Popen(["true"])
    gone.wait()
    patterns = (".dataset.json.{}", ".in_use.json.{}", ".work/probe-{}", ".work/.digests.json.{}", "count/.current.{}")
    names = [pattern.format(gone.pid) for pattern in patterns]
    for name in names:
        Path("d", name).touch()
    Path(f"d/.work/count/{key}/scratch").mkdir(parents=True)
    Path("d/.work/double/0123456789abcdef/scratch").mkdir(parents=True)  # another version's, unfinished: stays
    assert command("all", "--dataset", "d").ran == []
    assert not [n for n in names if Path("d", n).exists()] and not Path(f"d/.work/count/{key}").exists()
    assert Path("d/.work/double/0123456789abcdef/scratch").exists()


def test_what_a_run_beside_is_about_to_rename_stays(command, capture):
    command("all", capture.root, "--dataset", "d")
    aside = Path("d", f".dataset.json.{os.getppid()}")
    aside.touch()
    command("all", "--dataset", "d")
    assert aside.exists()


def test_faults_of_the_disk_are_one_line(command, refused, capture, stages):
    from pipeline.engine import cli

    house = cli.load_stages({})

    def full(stage):
        raise OSError(28, "No space left on device", str(stage.output / "x"))

    house["count"] = dataclasses.replace(house["count"], run=full)
    stopped = command("all", capture.root, "--dataset", "d")
    assert stopped.status == 2 and "no space left" in stopped.err and stopped.err.count("polarfield:") == 1
    assert "too long" in refused("all", "x" * 5000, "--dataset", "d").lower()
    assert len(refused("plan", capture.root, "--dataset", "/" + "y" * 5000)) < 1500


@pytest.mark.parametrize("value", ["inf", "nan", "1e400", "-inf"])
def test_numbers_past_all_sense_are_one_line(refused, capture, value):
    assert "factor" in refused("all", capture.root, "--dataset", "d", "--params", f"count.factor={value}")


@pytest.mark.parametrize("name", ["manifest.json.hdr", "...hdr", "....hdr", "ü [1].hdr", " .hdr", "a%b$c.hdr"])
def test_maps_may_have_any_name(command, capture, tmp_path, name):
    path = tmp_path / name
    path.write_text("light")
    made = command("all", capture.root, "--dataset", "d", "--envs", f"'{path}'")
    assert made.status == 0, made.err


def test_a_map_whose_name_is_no_text_is_told(refused, capture, tmp_path):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe.hdr")
    Path(path).write_text("light")
    assert "UTF-8" in refused("all", capture.root, "--dataset", "d", "--envs", f"'{path}'")


def test_plan_prints_the_warnings_of_a_run(command, capture, stages, monkeypatch):
    from pipeline.engine import cli, places

    house, run = cli.load_stages({}), stages["count"].run

    def warned(stage):
        stage.warn("number.txt: is small: check it")
        run(stage)

    house["count"] = dataclasses.replace(house["count"], run=warned)
    opened = places.open_capture
    monkeypatch.setattr(places, "open_capture", lambda p: dataclasses.replace(opened(p), warnings=("spare.txt: left out",)))
    assert "warning: spare.txt: left out" in command("plan", capture.root, "--dataset", "d").out
    command("all", capture.root, "--dataset", "d")
    for name in ("plan", "inspect"):
        said = command(name, "--dataset", "d").out
        assert "warning: spare.txt: left out" in said and "warning: number.txt: is small: check it" in said


def test_faults_of_files_that_only_later_stages_read_are_told_before_any_runs(command, refused, capture):
    from pipeline.engine import cli
    from pipeline.errors import UserError

    house = cli.load_stages({})

    def check(capture):
        if not (capture.root / "truth").exists():
            raise UserError(capture.root / "truth", "is no truth")

    house["metrics"] = dataclasses.replace(house["metrics"], check=check)
    assert "is no truth" in refused("all", capture.root, "--dataset", "d")
    assert "is no truth" in command("plan", capture.root, "--dataset", "d").err
    (capture.root / "truth").touch()
    assert command("all", capture.root, "--dataset", "d").status == 0
    (capture.root / "truth").unlink()
    assert command("all", capture.root, "--dataset", "d").status == 0  # metrics is done
