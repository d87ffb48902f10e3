"""Pictures of the wrong kind, count, channel or number format are told as what they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from pipeline.capture import open_capture
from pipeline.capture.recognition.still_detail import still_detail
from pipeline.errors import UserError
from pipeline.formats.images import write_exr
from synth import ball

CAMERAS = ball.ring(4, 96)
PICTURES = [ball.picture(camera) for camera in CAMERAS]


def said(root: Path) -> str:
    return "\n".join(open_capture(root).warnings)


def under_lights(count: int, size: int = 96):
    """The ellipsoid from one place, lit from around."""
    camera = ball.ring(1, size)[0]
    right, down, back = (s * camera.world_to_camera[k, :3] for k, s in ((0, 1), (1, -1), (2, -1)))
    for turn in 2 * np.pi * np.arange(count) / count:
        yield 0.9 * ball.picture(camera, 0.8 * (np.cos(turn) * right + np.sin(turn) * down) + 0.6 * back, ground=0.0)[0]


@pytest.mark.parametrize("count", [3, 4, 5])
def test_a_few_pictures_under_changing_light_are_told_as_that(count, tmp_path):
    for k, colour in enumerate(under_lights(count)):
        ball.write(tmp_path / "lights" / f"{'abcde'[k]}.png", ball.codes(colour))
    for k, camera in enumerate(ball.ring(count, 96)):
        ball.write(tmp_path / "views" / f"{'abcde'[k]}.png", ball.codes(ball.picture(camera)[0]))
    line = said(tmp_path / "lights")
    assert f"its {count} pictures show one framing under changing light" in line and "lacks its light table" in line
    assert said(tmp_path / "views") == ""


def test_detail_stays_under_moving_light_and_not_in_views():
    lit = np.stack([colour.mean(-1) for colour in under_lights(4)]).astype(float)
    views = np.stack([colour.mean(-1) for colour, _, _ in PICTURES]).astype(float)
    assert still_detail(lit) > 0.7 and still_detail(views) < 0.2 and still_detail(np.ones((3, 48, 48))) is None


@pytest.mark.parametrize("name", ["images/{}_{}.png", "{1}/{0}.png"])
@pytest.mark.parametrize("words", [("x", "p"), ("000", "090")])
def test_two_pictures_of_each_view_are_no_views_without_a_word(name, words, tmp_path):
    for k, (_, stokes, _) in enumerate(PICTURES):
        for word, degrees in zip(words, (0, 90)):
            ball.write(tmp_path / name.format(k, word), ball.codes(ball.behind(stokes, degrees)))
    assert "show one framing (4 of them): two angles of a polariser?" in said(tmp_path)


def test_stops_of_a_turntable_that_are_named_as_angles_are_doubted(tmp_path):
    for row, rise in (("low", 0.1), ("high", 0.6)):
        for k, camera in enumerate(ball.ring(8, 96, rises=(rise,))[:4]):
            ball.write(tmp_path / f"images/{row}_{45 * k:03d}.png", ball.codes(ball.picture(camera)[0]))
    faults = [" ".join(view.read().faults) for view in open_capture(tmp_path).views]
    assert len(faults) == 2 and all("stops of a turntable" in fault for fault in faults)
    (tmp_path / "capture.toml").write_text('layout = "photographs"\n')
    assert len(open_capture(tmp_path).views) == 8


def test_lights_in_folders_of_their_own_are_told(tmp_path):
    for k, camera in enumerate(CAMERAS):
        for n, light in enumerate(np.eye(3)):
            away = camera.world_to_camera[2, :3]
            colour = ball.picture(camera, (light - away) / np.linalg.norm(light - away))[0]
            ball.write(tmp_path / f"light{n}/{k}.png", ball.codes(colour))
    assert "light0, light1, light2 alone show one framing (4 of them) under changing light" in said(tmp_path)


def test_pairs_of_cameras_are_views(tmp_path):
    for k, camera in enumerate(CAMERAS):
        beside = camera.world_to_camera.copy()
        beside[0, 3] -= 0.15
        for side, pose in (("left", camera.world_to_camera), ("right", beside)):
            ball.write(tmp_path / f"images/{k}_{side}.png", ball.codes(ball.picture(replace(camera, world_to_camera=pose))[0]))
    assert said(tmp_path) == ""


@pytest.mark.parametrize("folder", ["polarizer_{}", "polariser{}", "deg{:03d}", "Polar-{}"])
def test_folders_named_after_a_filters_angle_are_a_stack(folder, tmp_path):
    for k, (_, stokes, _) in enumerate(PICTURES):
        for degrees in (0, 45, 90, 135):
            ball.write(tmp_path / "images" / folder.format(degrees) / f"{k}.png", ball.codes(ball.behind(stokes, degrees)))
    capture = open_capture(tmp_path)
    assert capture.polarisation == "stokes" and len(capture.views) == 4 and not capture.warnings


@pytest.mark.parametrize("name", ["images/{0}_{1}.png", "{1}/{0}.png"])
@pytest.mark.parametrize("words", [("s0", "s1", "s2"), ("s0", "dolp", "aolp")])
def test_pictures_of_stokes_components_are_refused(name, words, tmp_path):
    for k, (_, stokes, _) in enumerate(PICTURES):
        for plane, word in enumerate(words):
            ball.write(tmp_path / name.format(k, word), ball.codes(stokes[:, :, plane] / 2 + 0.5 * (plane > 0)))
    with pytest.raises(UserError, match=f"nothing but polarisation products .*: {', '.join(sorted(words))}"):
        open_capture(tmp_path)


def test_a_jpeg_of_a_mosaic_is_doubted(tmp_path):
    from PIL import Image

    (tmp_path / "images").mkdir()
    for k, (_, stokes, _) in enumerate(PICTURES):
        Image.fromarray(ball.codes(ball.mosaic(stokes), 8)).save(tmp_path / f"images/{k}.jpg", quality=95)
    capture = open_capture(tmp_path)
    assert capture.layout == "mosaic" and "0.jpg: JPEG mixes neighbours" in "\n".join(capture.warnings)


def test_a_dataset_is_no_capture(tmp_path):
    (tmp_path / "decode").mkdir()
    (tmp_path / "dataset.json").write_text("{}")
    with pytest.raises(UserError, match="is a dataset that was made from a capture"):
        open_capture(tmp_path)


def test_a_depth_channel_is_no_picture(tmp_path):
    for k, (colour, _, _) in enumerate(PICTURES):
        write_exr(tmp_path / f"images/{k}.exr", {"Z": colour[..., 0]})
    with pytest.raises(UserError, match=r"no colour channels \(it has Z\)"):
        open_capture(tmp_path).views[0].read()


@pytest.mark.parametrize("kind", ["int32", "uint32", "int16"])
def test_integers_that_no_camera_writes_are_doubted(kind, tmp_path):
    (tmp_path / "images").mkdir()
    for k, (colour, _, _) in enumerate(PICTURES):
        tifffile.imwrite(tmp_path / f"images/{k}.tif", (colour * 4095).astype(kind), photometric="rgb")
    assert "samples, which are read as parts of" in said(tmp_path)


def test_a_focal_length_in_millimetres_is_refused(tmp_path):
    for k, (colour, _, _) in enumerate(PICTURES):
        ball.write(tmp_path / f"images/{k}.png", ball.codes(colour))
    (tmp_path / "capture.toml").write_text("poses.focal_px = 4\n")
    with pytest.raises(UserError, match=r"poses\.focal_px = 4 is no focal length of pictures of 96 pixels"):
        open_capture(tmp_path)


def test_a_picture_too_many_does_not_shift_the_lights(tmp_path):
    for k in range(5):
        ball.write(tmp_path / f"{k + 1:03d}.png", np.full((16, 16, 3), 900 * (k + 1), np.uint16))
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0 1 1\n1 0 1\n1 1 1\n")
    with pytest.raises(UserError, match=r"lists 4 lights, but .* has 5 pictures, and nothing says which are theirs"):
        open_capture(tmp_path)
    (tmp_path / "filenames.txt").write_text("001.png\n002.png\n004.png\n005.png\n")
    (camera,) = open_capture(tmp_path).light_stage.cameras.values()
    assert [path.stem for path in camera.cross] == ["001", "002", "004", "005"]


def test_intrinsics_of_no_lens_and_of_larger_pictures(tmp_path):
    for k, (colour, _, _) in enumerate(PICTURES):
        ball.write(tmp_path / f"images/{k}.png", ball.codes(colour))
    table = ball.transforms(CAMERAS, [f"images/{k}.png" for k in range(4)])
    ball.save(tmp_path / "transforms.json", {**table, "fl_y": table["cx"], "cx": table["fl_y"]})
    with pytest.raises(UserError, match="are of no lens; give fx, fy, cx and cy in their order"):
        open_capture(tmp_path)
    ball.save(tmp_path / "transforms.json", {**table, "cx": 3 * table["cx"], "cy": 3 * table["cy"]})
    assert "principal points lie outside of the pictures (144, 144 of 96x96)" in said(tmp_path)


def test_pictures_of_lights_in_folders_that_are_no_passes_are_named(tmp_path):
    directions = ball.write_stage(tmp_path, 5, passes=("diffuse", "mixed"))
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    with pytest.raises(UserError, match=r"not called as passes are \(cam00/diffuse, cam00/mixed\); call them cross"):
        open_capture(tmp_path)
