"""What a user can get wrong: one line, exit status 2, no traceback, nothing half-written."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.formats.images import read_exr, read_mask, read_stokes, write_exr, write_mask, write_png, write_stokes

from .conftest import ROOT, Outcome, polarfield

pytestmark = pytest.mark.slow


@pytest.fixture
def views(captures, tmp_path) -> Path:
    """A copy of the multi-view capture to spoil."""
    return Path(shutil.copytree(captures / "views", tmp_path / "views"))


@pytest.fixture
def stage(captures, tmp_path) -> Path:
    """A copy of the light stage to spoil."""
    return Path(shutil.copytree(captures / "stage", tmp_path / "stage"))


def assert_refused(outcome: Outcome, *words: str, root: Path | None = None) -> None:
    """Status 2 and one line that names what is at fault."""
    assert outcome.status == 2, outcome.err
    assert "Traceback" not in outcome.err + outcome.out
    line = outcome.err.strip().splitlines()[-1]
    assert line.startswith("polarfield: "), outcome.err
    for word in words:
        assert word in line, line
    if root is not None and root.exists():
        published = [p for p in root.glob("*/*") if p.is_dir() and not p.is_symlink() and p.parent.name[0] != "."]
        assert all((p / "manifest.json").exists() for p in published)


def run(capture: Path, name: str = "masks", *more: object) -> Outcome:
    return polarfield(name, capture, "--dataset", capture.parent / "out", *more, timeout=120)


def test_empty_folder(tmp_path):
    (tmp_path / "hollow").mkdir()
    assert_refused(run(tmp_path / "hollow", "all"), "hollow", "empty")
    assert not (tmp_path / "out").exists()


def test_unknown_folder_lists_what_was_looked_for_and_found(tmp_path):
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "notes.txt").write_text("no pictures here")
    assert_refused(run(tmp_path / "odd", "all"), "transforms.json", "notes.txt")


def test_missing_folder(tmp_path):
    assert_refused(run(tmp_path / "nowhere", "all"), "nowhere")


@pytest.mark.parametrize("keep", [0, 100, 3000])
def test_truncated_image_is_named(views, keep):
    path = views / "images" / "005.exr"
    path.write_bytes(path.read_bytes()[:keep])
    assert_refused(run(views, "decode"), "005.exr", root=views.parent / "out")


def test_camera_without_an_image_is_named_and_left_out(views):
    (views / "images" / "004.exr").unlink()
    outcome = run(views)
    assert outcome.status == 0
    assert "warning" in outcome.err and "004.exr" in outcome.err
    made = {p.stem for p in (views.parent / "out" / "masks" / "current").glob("*.png")}
    assert made == {f"{k:03d}" for k in range(16)} - {"004"}


def test_image_without_a_camera_is_told(views):
    table = json.loads((views / "transforms.json").read_text())
    table["frames"].pop(3)
    (views / "transforms.json").write_text(json.dumps(table))
    outcome = run(views)
    assert outcome.status in (0, 2)
    assert "003" in outcome.err
    assert "Traceback" not in outcome.err


def test_mask_of_another_size_is_named(views):
    write_mask(views / "masks" / "002.png", np.ones((10, 20), bool))
    assert_refused(run(views), "002.png", root=views.parent / "out")


def test_black_masks_are_left_out_and_told_and_all_black_ones_refused(views):
    write_mask(views / "masks" / "002.png", np.zeros((64, 64), bool))
    outcome = run(views)
    assert outcome.status == 0 and "the mask is empty in 1 view (002)" in outcome.err + outcome.out
    for path in (views / "masks").iterdir():
        write_mask(path, np.zeros((64, 64), bool))
    assert_refused(run(views), "every mask is empty", root=views.parent / "out")


def test_white_masks_and_masks_of_ones_are_told(views):
    for path in sorted((views / "masks").iterdir())[:3]:
        write_mask(path, np.ones((64, 64), bool))
    for path in sorted((views / "masks").iterdir())[3:6]:
        write_png(path, read_mask(path).astype(np.uint8))
    outcome = run(views)
    told = outcome.err + outcome.out
    assert outcome.status == 0 and "3 masks white all over" in told and "its values are 0, 1" in told
    coverage = [
        v["coverage"] for v in json.loads((views.parent / "out/masks/current/masks.json").read_text())["views"].values()
    ]
    assert max(coverage) < 0.6 and min(coverage) > 0.02


def test_black_and_negative_captures_are_refused(views):
    for path in sorted((views / "images").iterdir()):
        image = read_exr(path)
        write_exr(path, {name: -np.abs(values) for name, values in image.items()})
    assert_refused(run(views, "decode"), "000.exr", "black or below 0", root=views.parent / "out")


def test_one_view_gives_what_one_view_can(views):
    table = json.loads((views / "transforms.json").read_text())
    table["frames"] = table["frames"][:1]
    (views / "transforms.json").write_text(json.dumps(table))
    for path in [*(views / "images").iterdir(), *(views / "masks").iterdir()]:
        if path.stem != "000":
            path.unlink()
    outcome = run(views, "all")
    assert outcome.status == 0, outcome.err
    assert "train: left out" in outcome.out + outcome.err
    assert (views.parent / "out" / "metrics" / "current" / "report.html").exists()
    again = run(views, "all")
    assert "left out" not in again.out + again.err  # nothing to do: nothing to say


@pytest.mark.parametrize("command", ["all", "gc"])
def test_dataset_that_is_none_is_named(tmp_path, command):
    assert_refused(polarfield(command, "--dataset", tmp_path / "nothing"), "nothing", "DATASET=")


def test_pixels_that_are_not_numbers_are_told_and_harmless(views):
    path = views / "images" / "001.exr"
    stokes = read_stokes(path)
    stokes[30, 30] = np.nan
    write_stokes(path, stokes)
    outcome = run(views, "decode")
    assert outcome.status == 0, outcome.err
    assert "001" in outcome.err and "warning" in outcome.err
    assert np.isfinite(read_stokes(views.parent / "out" / "decode" / "current" / "frames" / "001.exr")).all()


def test_a_black_image_is_told(views):
    path = views / "images" / "003.exr"
    write_stokes(path, 0 * read_stokes(path))
    outcome = run(views, "decode")
    assert outcome.status == 0 and "003.exr: every pixel is black" in outcome.err


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_light_table_of_another_length_is_named(stage, missing):
    lines = (stage / "lights.csv").read_text().splitlines()
    (stage / "lights.csv").write_text("\n".join(lines[:-missing]) + "\n")
    assert_refused(run(stage, "all"), "lights.csv", root=stage.parent / "out")


def test_missing_light_stage_frame_is_named(stage):
    (stage / "cam00" / "parallel" / "000007.exr").unlink()
    assert_refused(run(stage, "all"), "parallel", root=stage.parent / "out")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("olat.solvr=closed", ("solvr",)),
        ("mesh.voxel_px=tiny", ("voxel_px", "tiny")),
        ("mesh.voxel_px=99", ("voxel_px",)),
        ("paint.colour=red", ("paint",)),
        ("mesh", ("mesh",)),
    ],
)
def test_unknown_or_impossible_parameters_are_named(captures, tmp_path, text, words):
    assert_refused(polarfield("all", captures / "views", "--dataset", tmp_path / "d", "--params", text), *words)


def test_unknown_key_in_capture_toml_is_named(views):
    (views / "capture.toml").write_text("[stokes]\nscail = 2\n")
    assert_refused(run(views, "plan"), "capture.toml", "scail")


def test_environment_map_that_is_none(captures, tmp_path):
    envs = ("all", captures / "stage", "--dataset", tmp_path / "d", "--envs")
    assert_refused(polarfield(*envs, tmp_path / "no.hdr"), "no.hdr")
    (tmp_path / "text.hdr").write_text("hello")
    assert_refused(polarfield(*envs, tmp_path / "text.hdr"), "text.hdr", root=tmp_path / "d")


def test_target_that_cannot_be_written(captures, tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert_refused(polarfield("all", captures / "views", "--dataset", tmp_path / "file" / "d"), "file")
    assert_refused(polarfield("all", captures / "views", "--dataset", "/proc/polarfield"), "/proc/polarfield")


def in_a_small_disk(folder: Path, size: str, options: str, *arguments: object) -> Outcome:
    """Run polarfield where `folder` is a file system of its own; skips where that is not allowed."""
    folder.mkdir()
    mount = f"mount -t tmpfs -o size={size},{options} tmpfs '{folder}'"
    probe = subprocess.run(["unshare", "-rm", "sh", "-c", mount], capture_output=True, text=True)
    if probe.returncode:
        pytest.skip("this machine allows no mounts")
    line = " ".join(f"'{a}'" for a in (sys.executable, "-m", "stages", *arguments))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", f"{mount} && {line}"], capture_output=True, text=True, env=environment, timeout=120
    )
    return Outcome(done.returncode, done.stdout, done.stderr, 0)


@pytest.mark.parametrize("size", ["64k", "400k"])
def test_full_target_is_told(captures, tmp_path, size):
    target = tmp_path / "small"
    assert_refused(in_a_small_disk(target, size, "rw", "decode", captures / "views", "--dataset", target / "d"), "small")


def test_read_only_target_is_told(captures, tmp_path):
    target = tmp_path / "fixed"
    assert_refused(in_a_small_disk(target, "1m", "ro", "decode", captures / "views", "--dataset", target / "d"), "fixed")


def test_capture_is_never_written_to(views):
    before = {p: (p.stat().st_size, p.stat().st_mtime_ns) for p in views.rglob("*")}
    assert run(views).status == 0
    assert {p: (p.stat().st_size, p.stat().st_mtime_ns) for p in views.rglob("*")} == before
