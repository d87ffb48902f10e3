"""Versions: same inputs no work, changed parameter new version, whole or not at all."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.capture import Capture
from pipeline.engine.dataset import Dataset
from pipeline.engine.dataset.garbage import collection, remove
from pipeline.engine.execute import make_version
from pipeline.engine.memory import Allowance
from pipeline.engine.plan import Step, make_plan, parse_overrides
from pipeline.engine.progress import Progress
from pipeline.engine.stage import Stage, StageRun, parameters_from
from pipeline.errors import UserError

ANY_MEMORY = Allowance(100.0, 1, float("inf"))


def run_all(dataset: Dataset, capture: Capture, stages: dict[str, Stage], overrides: dict | None = None) -> list[Step]:
    dataset.prepare()
    steps = make_plan(capture, stages, overrides or {}, (), dataset.digests)
    for step in steps:
        if step.decision.run:
            dataset.use(make_version(dataset, capture, step, (), "cpu", ANY_MEMORY, Progress(quiet=True)))
    return steps


def test_a_stage_is_published_with_a_manifest_of_what_made_it(tmp_path, capture, stages):
    dataset = Dataset(tmp_path / "out")
    run_all(dataset, capture, stages)
    version = dataset.current("double")
    assert version is not None and (version.folder / "double.txt").read_text() == "84"
    manifest = version.manifest
    wanted = ["schema", "stage", "key", "version", "parameters", "inputs", "outputs", "started", "wall_s", "cpu_s"]
    assert not [key for key in wanted if key not in manifest]
    assert manifest["outputs"][0]["path"] == "double.txt" and manifest["peak_rss_mb"] > 1
    assert os.readlink(dataset.root / "double" / "current") == version.key


def test_the_same_inputs_do_no_work_and_a_moved_dataset_is_still_whole(tmp_path, capture, stages):
    dataset = Dataset(tmp_path / "out")
    first = run_all(dataset, capture, stages)
    (tmp_path / "out").rename(tmp_path / "moved")
    moved = Dataset(tmp_path / "moved")
    version = moved.current("count")
    assert version is not None
    before = (version.folder / "manifest.json").stat().st_mtime_ns
    second = run_all(moved, capture, stages)
    assert [s.key for s in first] == [s.key for s in second]
    assert (version.folder / "manifest.json").stat().st_mtime_ns == before


def test_a_changed_parameter_or_input_makes_a_new_version_beside_the_old_for_what_depends_on_it(tmp_path, capture, stages):
    dataset = Dataset(tmp_path / "out")
    run_all(dataset, capture, stages)
    run_all(dataset, capture, stages, {"count": {"factor": "3"}})
    assert (dataset.root / "double/current/double.txt").read_text() == "126"
    assert len([p for p in (dataset.root / "count").iterdir() if p.is_dir() and not p.is_symlink()]) == 2
    (capture.root / "number.txt").write_text("5")
    run_all(dataset, capture, stages)
    assert (dataset.root / "double/current/double.txt").read_text() == "20"
    gone = collection(dataset, stages).items
    remove(gone)
    assert len(gone) == 4 and (dataset.root / "double/current/double.txt").read_text() == "20"


def test_a_failed_stage_publishes_nothing_and_leaves_the_old_version_in_use(tmp_path, capture, stages):
    dataset = Dataset(tmp_path / "out")
    run_all(dataset, capture, stages)
    (capture.root / "number.txt").write_text("no number")
    with pytest.raises(ValueError):
        run_all(dataset, capture, stages)
    assert (dataset.root / "count/current/count.txt").read_text() == "42"


def test_a_version_with_a_missing_or_short_file_is_made_again(tmp_path, capture, stages):
    dataset = Dataset(tmp_path / "out")
    run_all(dataset, capture, stages)
    damaged = dataset.root / "count/current/count.txt"
    damaged.write_text("")
    run_all(dataset, capture, stages)
    assert damaged.read_text() == "42"


def test_the_scratch_folder_outlives_a_kill_and_wall_time_adds_up_over_the_legs(tmp_path, capture, stages, monkeypatch):
    monkeypatch.setattr("pipeline.engine.dataset.usage.Usage.INTERVAL_S", 0.05)

    def in_two_legs(run: StageRun) -> None:
        mark = run.scratch / "checkpoint"
        if not mark.exists():
            mark.write_text("half")
            time.sleep(0.3)  # long enough for the first leg's figures to be noted
            raise KeyboardInterrupt
        (run.output / "count.txt").write_text("42")

    import dataclasses

    stages["count"] = dataclasses.replace(stages["count"], run=in_two_legs)
    dataset = Dataset(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        run_all(dataset, capture, stages)
    assert dataset.current("count") is None
    run_all(dataset, capture, stages)
    version = dataset.current("count")
    assert version is not None and version.manifest["wall_s"] > 0.2


def test_a_second_run_waits_for_the_first_and_a_killed_one_lets_go(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from pipeline.engine.dataset import Dataset\n"
        "with Dataset(Path(sys.argv[1])).making('s', 'k', lambda: print('waiting', flush=True)):\n"
        "    print('held', flush=True); time.sleep(60)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]

    def begin() -> subprocess.Popen[str]:
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2])

    with begin() as first:
        assert first.stdout is not None and first.stdout.readline() == "held\n"
        with begin() as second:
            assert second.stdout is not None and second.stdout.readline() == "waiting\n"
            first.send_signal(signal.SIGKILL)
            assert second.stdout.readline() == "held\n"
            second.kill()


def test_the_digests_of_unchanged_files_are_not_computed_again(tmp_path, capture, stages, monkeypatch):
    dataset = Dataset(tmp_path / "out")
    dataset.prepare()
    make_plan(capture, stages, {}, (), dataset.digests)
    dataset.digests.save(dataset.write_text)
    monkeypatch.setattr("pipeline.engine.dataset.digests.digest_file", lambda path: pytest.fail(f"read {path} again"))
    make_plan(capture, stages, {}, (), Dataset(tmp_path / "out").digests)


def test_a_read_only_target_is_named_in_one_line(tmp_path):
    target = tmp_path / "file"
    target.write_text("")
    with pytest.raises(UserError) as caught:
        Dataset(target / "out").prepare()
    assert "\n" not in str(caught.value) and "DATASET=" in str(caught.value)


def test_parameters_are_checked_by_name_and_type(stages):
    stage = stages["count"]
    assert parameters_from(stage, {"factor": "3", "scale": "1e-3"}, "x").scale == 1e-3
    for bad in ({"factr": "3"}, {"factor": "3.5"}, {"scale": "wide"}):
        with pytest.raises(UserError, match="|".join(bad)):
            parameters_from(stage, bad, "PARAMS")
    with pytest.raises(UserError, match="form"):
        parse_overrides("count.factor", stages)
    with pytest.raises(UserError, match="no stage"):
        parse_overrides("cuont.factor=2", stages)


def test_passes_that_a_stage_left_out_are_noted_with_their_reason(tmp_path, capture, stages):
    dataset = Dataset(tmp_path / "out")
    run_all(dataset, capture, stages)
    version = dataset.current("count")
    assert version is not None
    assert json.loads((version.folder / "manifest.json").read_text())["facts"]["rare"]["run"] is False
