"""`plan` and `inspect` say what a run would of pixels, cameras, masks, and of a light stage's frames against its table."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.engine.cli import main
from pipeline.formats.images import STOKES, read_exr, write_exr, write_png
from stages import early_look
from stages.__main__ import PROGRAM
from synth import ball


@pytest.fixture
def polarfield(tmp_path, capsys):
    """Run a command in this process: (status, its warnings, its fault)."""

    def call(command, root):
        status = main(PROGRAM, [command, str(root), "--dataset", str(tmp_path / "dataset")])
        out = capsys.readouterr()
        warnings = [line.removeprefix("warning: ") for line in out.out.splitlines() if line.startswith("warning: ")]
        return SimpleNamespace(status=status, warnings=warnings, fault=out.err.strip())

    return call


def views(root, scene, write):
    write.stokes_transforms(root, scene)
    return sorted((root / "images").glob("*.exr"))


def spoil(path, change):
    channels = read_exr(path)
    change(channels)
    write_exr(path, channels, half=False)


@pytest.mark.parametrize("name", ["stokes_transforms", "polarisers_transforms", "pandora", "phygap_mitsuba"])
def test_sound_captures_get_no_word_and_no_dataset(tmp_path, scene, write, polarfield, name):
    root = tmp_path / "capture"
    root.mkdir()
    getattr(write, name)(root, scene)
    before = {p: p.stat().st_mtime_ns for p in root.rglob("*")}
    told = polarfield("plan", root)
    assert (told.status, told.warnings, told.fault) == (0, [], "")
    assert {p: p.stat().st_mtime_ns for p in root.rglob("*")} == before and not (tmp_path / "dataset").exists()


def test_pixels_that_decode_would_warn_of_are_told_by_plan_and_on_the_page(tmp_path, scene, write, polarfield):
    first, second, third = views(tmp_path / "capture", scene, write)
    spoil(first, lambda c: c["S0.R"].__setitem__((3, 4), np.nan))
    spoil(second, lambda c: [c[name].fill(0) for name in STOKES])
    spoil(third, lambda c: c["S1.G"].__imul__(100))
    for command in ("plan", "inspect"):
        told = polarfield(command, tmp_path / "capture")
        assert told.status == 0 and len(told.warnings) == len(set(told.warnings)) == 3
        for words in (f"{first}: 1 pixel not finite", f"{second}: every pixel is black", "DoLP is above 1"):
            assert any(words in line for line in told.warnings), words
    page = (tmp_path / "dataset-inspect" / "inspect.html").read_text()
    assert "1 pixel not finite" in page and "every pixel is black" in page


def test_a_fault_that_would_end_the_run_ends_plan_and_inspect_with_its_line(tmp_path, scene, write, polarfield):
    for path in views(tmp_path / "capture", scene, write):
        spoil(path, lambda c: [c[name].fill(0) for name in STOKES])
    for command in ("plan", "inspect"):
        told = polarfield(command, tmp_path / "capture")
        assert told.status == 2 and "every pixel of every view is black" in told.fault and "\n" not in told.fault
    assert "every pixel of every view is black" in (tmp_path / "dataset-inspect" / "inspect.html").read_text()


def test_masks_are_held_against_each_other(tmp_path, scene, write, polarfield):
    views(tmp_path / "capture", scene, write)
    for path in (tmp_path / "capture").rglob("*.png"):
        path.unlink()
    for name in scene.names:
        write_png(tmp_path / "capture" / "masks" / f"{name}.png", np.full((24, 32), 255, np.uint8))
    assert any("white all over" in line for line in polarfield("plan", tmp_path / "capture").warnings)


def test_what_a_finished_stage_has_said_is_not_said_twice(tmp_path, scene, write, polarfield):
    first, *_ = views(tmp_path / "capture", scene, write)
    spoil(first, lambda c: c["S0.R"].__setitem__((3, 4), np.nan))
    assert main(PROGRAM, ["decode", str(tmp_path / "capture"), "--dataset", str(tmp_path / "dataset"), "--alone"]) == 0
    assert sum("not finite" in line for line in polarfield("plan", tmp_path / "capture").warnings) <= 1


def around_a_ball(root, cameras):
    names = [f"images/{k:02d}.exr" for k in range(len(cameras))]
    for name, camera in zip(names, cameras):
        _, stokes, mask = ball.picture(camera)
        pixels = {c: stokes[..., i // 3, i % 3].astype(np.float32) for i, c in enumerate(STOKES)}
        write_exr(root / name, pixels, half=False)
        write_png(root / "masks" / Path(name).with_suffix(".png").name, np.where(mask, 255, 0).astype(np.uint8))
    (root / "transforms.json").write_text(json.dumps(ball.transforms(cameras, names)))
    return root


@pytest.mark.slow
def test_a_side_that_no_view_sees_is_told_before_the_run_and_not_by_a_part_of_the_views(tmp_path, polarfield, monkeypatch):
    root = around_a_ball(tmp_path / "above", ball.ring(12, rises=(0.9,)))
    told = polarfield("plan", root).warnings
    assert len(told) == 1 and "above: the underside of the object is seen by no view" in told[0] and "check that" in told[0]
    looked_at = {0, 2, 3, 5, 6, 8, 9, 11}  # eight of twelve, evenly
    rises = [0.9 if k in looked_at else -0.1 for k in range(12)]
    root = around_a_ball(tmp_path / "all-around", ball.ring(12, rises=rises))
    assert polarfield("plan", root).warnings == []
    whole = early_look.part_of
    monkeypatch.setattr(early_look, "part_of", lambda capture, pixels: whole(capture, 0))
    assert polarfield("plan", root).warnings == []


def test_cameras_that_look_away_are_told_where_masks_have_to_be_made(tmp_path, polarfield):
    root = around_a_ball(tmp_path / "capture", ball.ring(8))
    for path in (root / "masks").iterdir():
        path.unlink()
    assert not any("look away" in line for line in polarfield("plan", root).warnings)
    table = json.loads((root / "transforms.json").read_text())
    for frame in table["frames"]:  # OpenCV's axes in a table of OpenGL's
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) @ np.diag([1, -1, -1, 1])).tolist()
    (root / "transforms.json").write_text(json.dumps(table))
    assert any("look away" in line for line in polarfield("plan", root).warnings)


def test_of_a_large_capture_a_few_views_are_read(tmp_path):
    from pipeline.capture import open_capture

    root = around_a_ball(tmp_path, ball.ring(12))
    part, whole = early_look.part_of(open_capture(root), 0)
    assert not whole and len(part.views) == len(part.cameras) == 8 and part.views[0].view == "00"
    part, whole = early_look.part_of(open_capture(root), 1e9)
    assert whole and len(part.views) == 12


def stage(root, directions):
    ball.write_stage(root, lights=20)
    (root / "lights.csv").write_text(ball.lights_csv(directions))


@pytest.mark.slow
def test_a_light_table_in_another_frame_is_told_before_any_fit(tmp_path, polarfield):
    directions = ball.light_directions(20)
    stage(tmp_path / "sound", directions)
    told = polarfield("plan", tmp_path / "sound")
    assert told.status == 0 and not told.fault
    assert all("frames are black" in line for line in told.warnings), "beside the light behind the ball"
    stage(tmp_path / "mirrored", directions * [1, 1, -1])
    for command in ("plan", "inspect"):
        told = polarfield(command, tmp_path / "mirrored")
        assert "does not fit the frames" in " ".join([*told.warnings, told.fault])


def test_of_a_large_light_stage_a_few_lights_are_read(tmp_path):
    from pipeline.capture import open_capture

    stage(tmp_path, ball.light_directions(20))
    part, whole = early_look.part_of(open_capture(tmp_path), 16 * 16 * 2 * 5)
    (camera,) = part.light_stage.cameras.values()
    assert not whole and len(camera.cross) == len(camera.parallel) == 5
