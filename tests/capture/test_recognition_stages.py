"""Light stages are understood whatever their folders are called; pictures under one light each are never taken for views."""

import json
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.capture import open_capture
from pipeline.capture.layouts.ict_light_stage import read_camera
from pipeline.capture.recognition.one_framing import framing
from pipeline.errors import UserError
from pipeline.formats.images import read_image
from pipeline.geometry.cameras import frame_of
from synth import ball

LIGHTS = 12


def frames_fit(capture, directions, size=16):
    """Every frame shows the light that the table gives it."""
    stage = capture.light_stage
    np.testing.assert_allclose(stage.lights.directions, directions, atol=1e-6)
    for camera in stage.cameras.values():
        for paths, specular in ((camera.cross, False), (camera.parallel, True)):
            for path, light in zip(paths, directions):
                np.testing.assert_allclose(read_image(path)[..., :3], ball.stage_frame(light, specular, size), atol=1e-3)


@pytest.mark.parametrize("camera", ["Cam00", "camera_00", "Camera-0", "C000", "CAM 0", "cam00"])
@pytest.mark.parametrize("passes", [("cross", "parallel"), ("Cross", "Parallel"), ("xpol", "ppol"), ("crossed", "uncrossed"),
                                    ("Cross_Polarised", "Parallel-Polarized")])  # fmt: skip
def test_case_and_separators_of_folders_do_not_matter(camera, passes, tmp_path):
    directions = ball.write_stage(tmp_path, 5, camera, passes)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    ball.write(tmp_path / camera / "Mask.png", np.full((16, 16), 255, np.uint8))
    capture = open_capture(tmp_path)
    assert capture.kind == "light_stage" and list(capture.light_stage.cameras) == ["cam00"]
    assert capture.light_stage.cameras["cam00"].mask == tmp_path / camera / "Mask.png" and not capture.warnings
    frames_fit(capture, directions)


@pytest.mark.parametrize("nest", ["{which}/{camera}", "{which}", "frames/{camera}/{which}"])
def test_passes_above_cameras_or_alone(nest, tmp_path):
    directions = ball.write_stage(tmp_path, 5, nest=nest)
    (tmp_path / "Lights.csv").write_text(ball.lights_csv(directions))
    frames_fit(open_capture(tmp_path), directions)


@pytest.mark.parametrize("name", ["cam00.txt", "Camera_0.txt", "camera000.txt"])
def test_camera_files_of_other_names(name, tmp_path):
    directions = ball.write_stage(tmp_path, 4)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    (tmp_path / "cameras/camera00.txt").rename(tmp_path / "cameras" / name)
    frames_fit(open_capture(tmp_path), directions)


def test_a_stage_without_a_camera_file_is_told_its_form(tmp_path):
    directions = ball.write_stage(tmp_path, 4)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    (tmp_path / "cameras/camera00.txt").unlink()
    with pytest.raises(UserError, match=r"camera00\.txt: cam00 has images but no camera file; .*#focal length"):
        open_capture(tmp_path)


def other_cameras(root, kind, pictures, factor=1):
    """Cameras of a transforms.json, or of a COLMAP model in text, for the stage's own camera at `factor` times its size."""
    camera = read_camera(root / "cameras/camera00.txt", 16, 16).resized(16 * factor, 16 * factor)
    shutil.rmtree(root / "cameras")
    cameras = {name: replace(camera, fx=camera.fx + k) for k, name in enumerate(pictures)}
    if kind == "transforms":
        frames = [{"file_path": name, **frame_of(c)} for name, c in cameras.items()]
        (root / "transforms.json").write_text(json.dumps({"frames": frames}))
        return list(cameras.values())
    lines, poses = [], []
    for k, (name, c) in enumerate(cameras.items(), 1):
        x, y, z, w = Rotation.from_matrix(c.world_to_camera[:3, :3]).as_quat()
        lines.append(f"{k} PINHOLE {c.width} {c.height} {c.fx} {c.fy} {c.cx} {c.cy}")
        poses.append(" ".join(map(str, (k, w, x, y, z, *c.world_to_camera[:3, 3], k, name))) + "\n")
    (root / "sparse/0").mkdir(parents=True)
    for name, text in (("cameras", lines), ("images", poses), ("points3D", [])):
        (root / f"sparse/0/{name}.txt").write_text("\n".join(text) + "\n")
    return list(cameras.values())


@pytest.mark.parametrize("kind", ["transforms", "colmap"])
@pytest.mark.parametrize("nest", ["{camera}/{which}", "{which}/{camera}"])
@pytest.mark.parametrize(("pictures", "factor"), [(["shot/cam01.png", "Cam_00/x.jpg"], 1), (["c1_all.png", "c0_all.png"], 4)])
def test_cameras_of_other_programs(kind, nest, pictures, factor, tmp_path):
    directions = ball.write_stage(tmp_path, 4, nest=nest)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    true = other_cameras(tmp_path, kind, pictures, factor)[1].resized(16, 16)
    capture = open_capture(tmp_path)
    found = capture.cameras["cam00"]
    assert capture.kind == "light_stage" and (found.width, found.height) == (16, 16)
    assert np.allclose(found.intrinsics, true.intrinsics) and np.allclose(found.world_to_camera, true.world_to_camera)
    assert any(p.name in ("transforms.json", "images.txt") for p in capture.files)


@pytest.mark.parametrize("kind", ["transforms", "colmap"])
def test_a_table_that_does_not_name_a_camera_is_asked_to(kind, tmp_path):
    (tmp_path / "lights.csv").write_text(ball.lights_csv(ball.write_stage(tmp_path, 4)))
    other_cameras(tmp_path, kind, ["cam03/a.png", "cam04/a.png"])
    with pytest.raises(UserError, match=r"names no picture of cam00 \(first: cam03/a\.png\); name a picture of each camera"):
        open_capture(tmp_path)


def test_the_folder_above_a_stage_is_told_from_a_stage_without_a_camera_file(tmp_path):
    directions = ball.write_stage(tmp_path / "ball", 4)
    (tmp_path / "ball" / "lights.csv").write_text(ball.lights_csv(directions))
    with pytest.raises(UserError, match=r"not the light stage itself: that is ball; give CAPTURE=.*/ball$"):
        open_capture(tmp_path)


# ---- frames and lights -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("first", "base", "dead", "extra"),
    [
        (0, 0, (4, 7), 0), (2, 0, (4, 7), 0), (1, 1, (4, 7), 0), (2, 1, (4,), 0), (0, 1, (4,), 0), (0, 0, (0, 5), 0),
        (2, 0, (0,), 0), (2, 0, (4,), 2), (101, 101, (4,), 0), (2, 2, (3,), 0), (2, 0, (), 2), (2, 0, (11,), 0),
    ],
)  # fmt: skip
def test_the_light_of_index_i_is_frame_i(first, base, dead, extra, tmp_path):
    """Dead lights are left out of the table, their (black) frames are there; `extra` frames lead and trail."""
    directions = ball.write_stage(tmp_path, LIGHTS, first=first)
    for number in (*range(extra), *range(first + LIGHTS, first + LIGHTS + extra)):
        for which in ("cross", "parallel"):
            ball.write(tmp_path / f"cam00/{which}/{number:06d}.exr", np.full((16, 16, 3), 9, np.float32))
    keep = [k for k in range(LIGHTS) if k not in dead]
    for k in dead:
        for which in ("cross", "parallel"):
            ball.write(tmp_path / f"cam00/{which}/{k + first:06d}.exr", np.zeros((16, 16, 3), np.float32))
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions[keep], [k + base for k in keep]))
    capture = open_capture(tmp_path)
    frames_fit(capture, directions[keep])
    assert not any(
        p.stem == f"{k + first:06d}" for k in dead if 0 < k < 11 for p in capture.light_stage.cameras["cam00"].full_light
    )
    assert not dead or set(dead) <= {0, 11} or "lights that the table leaves out" in " ".join(capture.facts)


@pytest.mark.parametrize("frames", [13, 11, 15])
def test_numbers_that_leave_the_first_light_open_ask_for_it(frames, tmp_path):
    directions = ball.write_stage(tmp_path, frames)
    kept = directions[:LIGHTS] if frames > LIGHTS else ball.light_directions(LIGHTS)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(kept))
    with pytest.raises(UserError, match=r"lights\.csv: lists 12 lights .* first_frame"):
        open_capture(tmp_path)
    if frames > LIGHTS:
        (tmp_path / "capture.toml").write_text("[olat]\nfirst_frame = 0\n")
        frames_fit(open_capture(tmp_path), kept)


@pytest.mark.parametrize("name", ["{:06d}_ev-2.exr", "{:06d}_v2.exr", "L{:03d}.exr", "take2_{:04d}_cam00.exr"])
def test_of_several_numbers_in_a_name_the_one_that_changes_counts(name, tmp_path):
    directions = ball.write_stage(tmp_path, LIGHTS, name=name)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    frames_fit(open_capture(tmp_path), directions)


def test_frames_that_are_not_read_are_named(tmp_path):
    (tmp_path / "lights.csv").write_text(ball.lights_csv(ball.light_directions(3)))
    for which in ("cross", "parallel"):
        (tmp_path / "cam00" / which).mkdir(parents=True)
        for k in range(3):
            (tmp_path / "cam00" / which / f"{k}.MAT").write_bytes(b"x")
    with pytest.raises(UserError, match=r"holds no frame that is read, but 3 \.mat files"):
        open_capture(tmp_path)


def test_a_fractional_index_is_refused(tmp_path):
    directions = ball.write_stage(tmp_path, 3)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions, [0, 1.5, 2]))
    with pytest.raises(UserError, match=r"index 1\.5 is no whole number"):
        open_capture(tmp_path)


# ---- tables of photometric stereo ------------------------------------------------------------------------------------
@pytest.mark.parametrize("order", [1, -1])
def test_an_lp_table_names_each_lights_frame(order, tmp_path):
    directions = ball.write_stage(tmp_path, LIGHTS, first=2)
    rows = [f"images\\{k + 2:06d}.jpg {x:.9f} {y:.9f} {z:.9f}" for k, (x, y, z) in enumerate(directions)][::order]
    (tmp_path / "dome.lp").write_text("\n".join([str(LIGHTS), *rows]) + "\n")
    frames_fit(open_capture(tmp_path), directions[::order])


def test_light_directions_with_names_and_intensities(tmp_path):
    directions = ball.write_stage(tmp_path, LIGHTS, first=1, name="{:03d}.png")
    np.savetxt(tmp_path / "light_directions.txt", directions)
    np.savetxt(tmp_path / "light_intensities.txt", np.linspace(1, 2, LIGHTS)[:, None] * [1, 1, 1])
    (tmp_path / "filenames.txt").write_text("".join(f"{k + 1:03d}.png\n" for k in range(LIGHTS)))
    lights = open_capture(tmp_path).light_stage.lights
    np.testing.assert_allclose(lights.directions, directions, atol=1e-6)
    np.testing.assert_allclose(lights.intensity / lights.intensity[0], np.linspace(1, 2, LIGHTS), rtol=1e-6)


@pytest.mark.parametrize("text", ["x\n", "3\na 0 0 1\n", "1\na 0 1\n", "1\na 0 0 up\n"])
def test_a_damaged_lp_table_is_one_line(text, tmp_path):
    ball.write_stage(tmp_path, 3)
    (tmp_path / "dome.lp").write_text(text)
    with pytest.raises(UserError) as caught:
        open_capture(tmp_path)
    assert caught.value.remedy and (not text[0].isdigit() or str(caught.value).startswith(str(tmp_path / "dome.lp")))


def lit_from_around(root, count=13, name="{:03d}.png", ambient=0.0, size=96):
    """Pictures of the ellipsoid by one camera under one light each; returns the directions."""
    camera = ball.ring(1, size)[0]
    right, down, back = (s * camera.world_to_camera[k, :3] for k, s in ((0, 1), (1, -1), (2, -1)))
    turns = 2 * np.pi * np.arange(count) / count
    lights = [0.8 * (np.cos(t) * right + np.sin(t) * down) + 0.6 * back for t in turns]
    for k, light in enumerate(lights):
        pixels = ball.picture(camera, light, ground=0.0)[0]
        ball.write(root / name.format(k), ball.codes(0.9 * pixels + ambient, 16))
    return np.array(lights)


@pytest.mark.parametrize("table", ["light_directions.txt", "dome.lp", "lights.csv", "Dome RTI.LP"])
@pytest.mark.parametrize("place", ["", "images/", "ballPNG/"])
def test_a_light_table_beside_pictures_is_a_stage_of_one_pass(table, place, tmp_path):
    """Photometric stereo's folders, with the mask and the truth that lie among the pictures."""
    for k in range(4):
        ball.write(tmp_path / f"{place}{k:03d}.png", np.full((16, 16, 3), 900 * (k + 1), np.uint16))
    for name in ("mask.png", "Normal_gt.png"):
        ball.write(tmp_path / f"{place}{name}", np.full((16, 16, 3), 65535, np.uint16))
    directions = [(0.1 * k, 0.2, 1) for k in range(4)]
    rows = {".txt": [f"{x} {y} {z}" for x, y, z in directions],
            ".csv": ["index,x,y,z", *(f"{k},{x},{y},{z}" for k, (x, y, z) in enumerate(directions))]}  # fmt: skip
    named = ["4", *(f"{k:03d}.png {x} {y} {z}" for k, (x, y, z) in enumerate(directions))]
    (tmp_path / (place if place != "images/" else "") / table).write_text("\n".join(rows.get(table[-4:], named)) + "\n")
    capture = open_capture(tmp_path)
    camera = capture.light_stage.cameras["cam00"]
    assert camera.passes == "none" and [p.stem for p in camera.frames] == ["000", "001", "002", "003"]
    assert camera.mask.name == "mask.png" and any("without polarisers" in fact for fact in capture.facts)
    np.testing.assert_allclose(camera.camera.rays(), np.broadcast_to([0, 0, -1], (16, 16, 3)), atol=2e-3)
    unit = np.array(directions) / np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(capture.light_stage.lights.directions, unit, atol=1e-6)


def test_half_of_a_table_beside_pictures_is_one_line(tmp_path):
    for k in range(3):
        ball.write(tmp_path / f"{k:03d}.png", np.full((16, 16, 3), 900 * (k + 1), np.uint16))
    (tmp_path / "LSX3_light_positions.txt").write_text("0 0 1\n" * 3)
    with pytest.raises(UserError, match="LSX3"):
        open_capture(tmp_path)


@pytest.mark.parametrize("kept", ["cross", "parallel"])
def test_a_camera_may_have_one_pass_alone(kept, tmp_path):
    directions = ball.write_stage(tmp_path, LIGHTS)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    for folder in list(tmp_path.rglob("*")):
        if folder.is_dir() and folder.name in {"cross", "parallel"} - {kept}:
            shutil.rmtree(folder)
    capture = open_capture(tmp_path)
    cameras = capture.light_stage.cameras.values()
    assert cameras and all(c.passes == kept and len(c.frames) == LIGHTS and c.cross == c.parallel for c in cameras)


def test_each_lights_colour_is_taken_out_of_its_frame(tmp_path):
    directions = ball.write_stage(tmp_path, LIGHTS, name="{:03d}.png")
    np.savetxt(tmp_path / "light_directions.txt", directions)
    colours = 1 + 0.3 * np.sin(np.arange(3 * LIGHTS)).reshape(LIGHTS, 3)
    np.savetxt(tmp_path / "light_intensities.txt", colours)
    lights = open_capture(tmp_path).light_stage.lights
    white = lights.intensity[:, None] / lights.gains
    np.testing.assert_allclose(white / white[0], colours / colours[0], rtol=1e-6)


def test_a_linear_program_is_no_light_table(tmp_path):
    for k in range(3):
        ball.write(tmp_path / f"images/{k}.png", np.full((16, 16, 3), 900 * (k + 1), np.uint16))
    (tmp_path / "model.lp").write_text("Maximize\n obj: x\n")
    assert open_capture(tmp_path).layout == "photographs"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace(",", ";"), "semicolons or tabs"),
        (lambda text: text.replace(",", "\t"), "semicolons or tabs"),
        (lambda text: text.split("\n", 1)[1], "it begins with numbers"),
        (lambda text: text.replace("index,x,y,z", "light,lx,ly,lz"), "it has light,lx,ly,lz"),
    ],
)
def test_a_table_without_its_columns_is_told_why(change, words, tmp_path):
    directions = ball.write_stage(tmp_path, 4)
    (tmp_path / "lights.csv").write_text(change(ball.lights_csv(directions)))
    with pytest.raises(UserError, match=rf"lights\.csv: has no column .*{words}"):
        open_capture(tmp_path)
    (tmp_path / "lights.csv").write_bytes(ball.lights_csv(directions).encode("utf-16"))
    with pytest.raises(UserError, match="UTF-16"):
        open_capture(tmp_path)


def test_masks_that_are_not_read_and_cameras_that_look_away_are_told(tmp_path):
    directions = ball.write_stage(tmp_path, 4)
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    assert open_capture(tmp_path).warnings == ()
    np.save(tmp_path / "cam00" / "mask.npy", np.ones((16, 16)))
    path = tmp_path / "cameras" / "camera00.txt"
    path.write_text(path.read_text().replace("0 0 1 400", "0 0 1 -400"))
    mask, away = open_capture(tmp_path).warnings
    assert "mask.npy: is no mask that is read" in mask and "the stage's centre (0, 0, 0) lies behind cam00" in away


@pytest.mark.parametrize("kind", ["lp", "filenames"])
@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["003.png", "002.png", "O01.png", "000.png"], r"names O01\.png, which .* has not \(1 of 4 lights\)"),
        (["003.png", "002.png", "002.png", "000.png"], r"names 002\.png twice"),
        (["a.png", "b.png", "c.png", "d.png"], None),
    ],
)
def test_names_of_a_light_table_that_miss_pictures_are_never_passed_over(kind, names, words, tmp_path):
    """Without them light k would be picture k, whatever order the table is in."""
    for k in range(4):
        ball.write(tmp_path / f"{k:03d}.png", np.full((16, 16, 3), 900 * (k + 1), np.uint16))
    rows = [f"{0.1 * k} 0.2 1" for k in range(4)]
    if kind == "lp":
        (tmp_path / "dome.lp").write_text("4\n" + "\n".join(f"{n} {row}" for n, row in zip(names, rows)))
    else:
        (tmp_path / "light_directions.txt").write_text("\n".join(rows))
        (tmp_path / "filenames.txt").write_text("\n".join(names))
    if words is None:
        (line,) = open_capture(tmp_path).warnings
        assert "none of the pictures that the table names is here (a.png, b.png" in line
        return
    with pytest.raises(UserError, match=words):
        open_capture(tmp_path)


def test_names_that_do_not_count_the_lights_are_refused(tmp_path):
    for k in range(4):
        ball.write(tmp_path / f"{k:03d}.png", np.full((16, 16, 3), 900 * (k + 1), np.uint16))
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0 1 1\n1 0 1\n1 1 1\n")
    (tmp_path / "filenames.txt").write_text("000.png\n001.png\n002.png\n")
    with pytest.raises(UserError, match=r"filenames\.txt: names 3 pictures, light_directions\.txt has 4 lights"):
        open_capture(tmp_path)


# ---- one framing, seen in the pictures -------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize("count", [6, 8, 13, 40])
@pytest.mark.parametrize("ambient", [0.0, 0.08])
@pytest.mark.parametrize("name", ["{:03d}.png", "images/IMG_{:04d}.png"])
def test_one_framing_under_changing_light_is_refused(count, ambient, name, tmp_path):
    lit_from_around(tmp_path, count, name, ambient)
    with pytest.raises(UserError, match=r"one framing under changing light.*light table"):
        open_capture(tmp_path)
    (tmp_path / "capture.toml").write_text('layout = "photographs"\n')
    assert len(open_capture(tmp_path).views) == count


def test_one_framing_a_folder_is_refused_too(tmp_path):
    """Passes without a light table, or cameras of a dome: each folder has a framing of its own."""
    lit_from_around(tmp_path, 8, "left/{:03d}.png")
    for k in range(8):
        pixels = read_image(tmp_path / f"left/{k:03d}.png")
        ball.write(tmp_path / f"right/{k:03d}.png", ball.codes(pixels[:, ::-1]))
    with pytest.raises(UserError, match="one framing"):
        open_capture(tmp_path)


def test_an_ambient_picture_among_them_does_not_hide_it(tmp_path):
    lit_from_around(tmp_path, 8, "image{}.png")
    camera = ball.ring(1, 96)[0]
    ball.write(tmp_path / "image_ambient.png", ball.codes(0.3 * ball.picture(camera, -ball.SUN, ground=0.0)[0]))
    with pytest.raises(UserError, match="one framing"):
        open_capture(tmp_path)


BACKGROUND = np.random.default_rng(1).uniform(0.1, 0.6, (96, 96, 1)).astype(np.float32) * np.ones(3, np.float32)


def turntable(count, span=360.0, texture=1.0, ground=None):
    camera = ball.ring(1, 96)[0]
    for k in range(count):
        colour, _, mask = ball.picture(camera, turn_deg=span * k / count, texture=texture, ground=0.0)
        yield colour if ground is None else np.where(mask[..., None], colour, ground)


def around(count, texture=1.0):
    for camera in ball.ring(count, 96):
        yield ball.picture(camera, texture=texture)[0]


def dial(count):
    stokes = ball.picture(ball.ring(1, 96)[0])[1].copy()
    stokes[:, :, 1:] *= 2  # DoLP up to 0.7
    for k in range(count):
        yield ball.behind(stokes, 180 * k / count)


def bracket(count):
    colour = ball.picture(ball.ring(1, 96)[0])[0]
    for k in range(count):
        yield np.minimum(colour * 2.0 ** (k - count + 2), 1)


def sliding(count, most):
    """A textured plane that slides by up to `most` pixels, as small steps of a camera do."""
    from scipy.ndimage import gaussian_filter, shift

    plane = gaussian_filter(np.random.default_rng(2).uniform(0, 1, (130, 130)), 2)
    plane = (plane - plane.min()) / np.ptp(plane)
    for k in range(count):
        turn = 2 * np.pi * k / count
        yield shift(plane, (most * np.cos(turn), most * np.sin(turn)), order=1)[17:113, 17:113, None] * np.ones(3)


def grainy(pictures: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Pictures with a sensor's noise: no two of them are alike in every byte."""
    rng = np.random.default_rng(4)
    for picture in pictures:
        yield np.maximum(picture + rng.normal(0, 0.003, picture.shape), 0)


VIEWS = {
    "all around": lambda: around(12),
    "all around, even": lambda: around(12, 0.0),
    "six views": lambda: around(6),
    "turntable": lambda: turntable(12),
    "turntable before a still background": lambda: turntable(12, ground=BACKGROUND),
    "turntable before white": lambda: turntable(8, ground=0.9),
    "an even object on a turntable": lambda: grainy(turntable(12, texture=0.0, ground=BACKGROUND)),
    "a few degrees of a turntable": lambda: turntable(10, 30.0, ground=BACKGROUND),
    "a quarter turn": lambda: turntable(8, 90.0),
    "a dial": lambda: dial(12),
    "a bracket": lambda: bracket(7),
    "a sliding camera": lambda: sliding(12, 15.0),
    "a camera that hardly moves": lambda: sliding(12, 1.5),
    "two pictures": lambda: around(2),
}


@pytest.mark.parametrize("what", VIEWS)
def test_views_stacks_and_brackets_are_not_taken_for_one_framing(what, tmp_path):
    for k, pixels in enumerate(VIEWS[what]()):
        ball.write(tmp_path / f"images/IMG_{k:04d}.png", ball.codes(pixels))
    capture = open_capture(tmp_path)
    assert capture.layout == "photographs" and not capture.warnings


def test_the_limits_keep_a_margin_on_both_sides(tmp_path):
    """Of every figure the nearest view or light stage of this file stays off the limit by a tenth of the gap."""
    lit_from_around(tmp_path, 12)
    lit = framing(np.stack([read_image(p)[..., :3].mean(-1) for p in sorted(tmp_path.glob("*.png"))]).astype(float))
    assert lit.explained > 0.95 and lit.in_place < 0.4 and lit.strength > 0.4
    for what in ("all around", "turntable", "a quarter turn", "a sliding camera"):
        views = framing(np.stack([p.mean(-1) for p in VIEWS[what]()]).astype(float))
        assert views.explained < 0.8 or views.in_place > 0.7, what
