"""What lies beside the pictures under another name, in another place or in another form is named, and never passed over."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.errors import UserError
from pipeline.formats.images import srgb_encode
from stages.calib.poses.write import write_sparse
from synth import ball

CAMERAS = ball.ring(4)
PICTURES = [ball.picture(camera) for camera in CAMERAS]


def photographs(root, name="images/{:03d}.png"):
    for k, (colour, _, _) in enumerate(PICTURES):
        ball.write(root / name.format(k), ball.codes(srgb_encode(colour), 8))


def with_table(root):
    photographs(root)
    ball.save(root / "transforms.json", ball.transforms(CAMERAS, [f"images/{k:03d}.png" for k in range(4)]))


def said(root) -> str:
    return "\n".join(open_capture(root).warnings)


# ---- settings --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["capture.toml.txt", "Capture.toml", "images/capture.toml", "bust/capture.toml"])
def test_settings_that_would_not_be_read_are_refused(name, tmp_path):
    photographs(tmp_path, "bust/images/{:03d}.png" if name.startswith("bust") else "images/{:03d}.png")
    (tmp_path / name).write_text('up = "z"\n')
    with pytest.raises(UserError, match=rf"{name}: .*not read.*(rename it|move it up)"):
        open_capture(tmp_path)


@pytest.mark.parametrize("name", ["captures.toml", "settings.toml", "capture.yaml"])
def test_what_may_be_settings_is_named(name, tmp_path):
    photographs(tmp_path)
    (tmp_path / name).write_text('up = "z"\n')
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "x"\n')
    assert f"{name}: is not read" in said(tmp_path)
    (tmp_path / "capture.toml").write_text("")
    assert said(tmp_path) == ""


def test_polarisers_at_one_angle_and_settings_of_stokes_vectors_without_any_are_told(tmp_path):
    photographs(tmp_path)
    table = ball.transforms(CAMERAS, [f"images/{k:03d}.png" for k in range(4)])
    for k, frame in enumerate(table["frames"]):
        frame["camera"] = "ab"[k % 2]
    ball.save(tmp_path / "transforms.json", table)
    for angle, alike in ((190, True), (100, False)):
        (tmp_path / "capture.toml").write_text(f"polarisers.a.angle_deg = 10\npolarisers.b.angle_deg = {angle}\n")
        assert ("all stand at 10 degrees" in said(tmp_path)) is alike
    (tmp_path / "capture.toml").write_text("stokes.flip_s2 = true\n")
    with pytest.raises(UserError, match=r"\[stokes\] is set, but"):
        open_capture(tmp_path)


def test_exposures_of_some_views_are_said(tmp_path):
    with_table(tmp_path)
    (tmp_path / "capture.toml").write_text('[radiometry]\nexposure_s = { "000" = 0.02 }\n')
    assert "exposure_s tells 1 of 4 views (not 001, 002, 003)" in said(tmp_path)


# ---- cameras ---------------------------------------------------------------------------------------------------------
def a_file_each(root):
    (root / "pose").mkdir()
    for k, camera in enumerate(CAMERAS):
        np.savetxt(root / f"pose/{k:03d}.txt", camera.camera_to_world)


def xmp(root):
    for k in range(4):
        (root / f"images/{k:03d}.xmp").write_text("<xcr:Rotation>1 0 0 0 1 0 0 0 1</xcr:Rotation>")


def one_file(root):
    rows = [f"{k:03d}.png," + ",".join(f"{x:.6f}" for x in c.world_to_camera[:3].ravel()) for k, c in enumerate(CAMERAS)]
    (root / "poses.csv").write_text("\n".join(rows))


def other_table(root):
    ball.save(root / "transforms_all.json", ball.transforms(CAMERAS, [f"images/{k:03d}.png" for k in range(4)]))


def model_elsewhere(root):
    write_sparse(root / "reconstruction" / "model", {f"{k:03d}.png": c for k, c in enumerate(CAMERAS)})


def half_model(root):
    write_sparse(root / "sparse" / "0", {f"{k:03d}.png": c for k, c in enumerate(CAMERAS)})
    (root / "sparse" / "0" / "images.txt").unlink()


def calibration(root):
    (root / "calib.yml").write_text("camera_matrix: !!opencv-matrix\n")


def arrays(root):
    np.savez(root / "cameras.npz", **{f"camera_mat_{k}": c.camera_to_world for k, c in enumerate(CAMERAS)})


def array(root):
    np.save(root / "poses.npy", np.stack([c.camera_to_world for c in CAMERAS]))


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (a_file_each, "pose: a file of numbers for each picture"),
        (xmp, "images: a file of numbers for each picture"),
        (one_file, "poses.csv: names the pictures"),
        (other_table, "transforms_all.json: looks like a table of cameras"),
        (model_elsewhere, "model: a COLMAP model is not looked for here"),
        (half_model, "sparse/0: holds cameras.txt, points3D.txt and no whole model"),
        (calibration, "calib.yml: looks like the calibration of a lens"),
        (array, "poses.npy: holds a matrix for each picture"),
        (arrays, "cameras.npz: holds a matrix for each picture"),
    ],
)
def test_cameras_that_are_not_read_are_named(write, words, tmp_path):
    photographs(tmp_path)
    write(tmp_path)
    assert words in said(tmp_path)


def test_notes_and_development_settings_beside_pictures_are_no_cameras(tmp_path):
    photographs(tmp_path)
    (tmp_path / "notes.csv").write_text("".join(f"{k:03d}.png,0.01,5.6\n" for k in range(4)))
    (tmp_path / "meta.json").write_text(json.dumps({f"{k:03d}.png": {"iso": 100} for k in range(4)}))
    for k in range(4):
        (tmp_path / f"images/{k:03d}.xmp").write_text("<crs>" + " ".join(f"+0.{n}5" for n in range(20)) + "</crs>")
    assert said(tmp_path) == ""


def test_a_model_that_is_not_what_its_text_says_is_named(tmp_path):
    import pycolmap

    photographs(tmp_path)
    model = tmp_path / "sparse" / "0"
    named = {f"{k:03d}.png": c for k, c in enumerate(CAMERAS)}
    write_sparse(model, named)
    pycolmap.Reconstruction(str(model)).write_binary(str(model))
    assert said(tmp_path) == ""
    write_sparse(model, {name: replace(c, fx=1.5 * c.fx) for name, c in named.items()})
    assert "as binary and as text, and they differ" in said(tmp_path)


# ---- masks -----------------------------------------------------------------------------------------------------------
def test_masks_of_a_kind_that_is_not_read_are_refused(tmp_path):
    with_table(tmp_path)
    (tmp_path / "masks").mkdir()
    assert "masks: is empty" in said(tmp_path)
    for k, (_, _, mask) in enumerate(PICTURES):
        np.save(tmp_path / f"masks/{k:03d}.npy", mask)
    with pytest.raises(UserError, match=r"masks: holds 4 files \(000\.npy.*none of which is a mask"):
        open_capture(tmp_path)


def test_two_masks_of_one_view_are_refused(tmp_path):
    with_table(tmp_path)
    for k, (_, _, mask) in enumerate(PICTURES):
        for suffix in ("png", "jpg")[: 1 + (k == 2)]:
            ball.write(tmp_path / f"masks/{k:03d}.{suffix}", mask.astype(np.uint8) * 255)
    with pytest.raises(UserError, match=r"002\.png: is the mask of the same view as 002\.jpg"):
        open_capture(tmp_path)


def test_frames_without_mask_or_camera_beside_those_that_name_one_are_said(tmp_path):
    photographs(tmp_path)
    ball.write(tmp_path / "masks/000.png", PICTURES[0][2].astype(np.uint8) * 255)
    table = ball.transforms(CAMERAS, [f"images/{k:03d}.png" for k in range(4)])
    table["frames"][0].update(mask_path="masks/000.png", camera="left")
    ball.save(tmp_path / "transforms.json", table)
    assert "no mask_path for 3 views (001, 002, 003)" in said(tmp_path) and "3 frames (images/001.png" in said(tmp_path)


def test_a_mask_of_no_view_is_named(tmp_path):
    with_table(tmp_path)
    ball.write(tmp_path / "mask.png", PICTURES[0][2].astype(np.uint8) * 255)
    assert "mask.png: is of no view" in said(tmp_path)


@pytest.mark.parametrize("opaque", [False, True])
def test_alpha_in_some_pictures_alone_is_said_where_it_cuts_something_out(opaque, tmp_path):
    with_table(tmp_path)
    for k in (1, 2):
        colour, _, mask = PICTURES[k]
        alpha = np.maximum(mask.astype(np.uint8), opaque) * 255
        ball.write(tmp_path / f"images/{k:03d}.png", np.dstack([ball.codes(srgb_encode(colour), 8), alpha]))
    assert ("2 of 4 images have an alpha" in said(tmp_path)) is not opaque


# ---- pictures --------------------------------------------------------------------------------------------------------
def test_another_folder_of_pictures_is_named(tmp_path):
    photographs(tmp_path)
    photographs(tmp_path, "images_2/{:03d}.png")
    assert said(tmp_path) == ""
    photographs(tmp_path, "photos/{:03d}.png")
    assert "photos: its 4 pictures are not used" in said(tmp_path)


def test_archives_are_to_be_unpacked(tmp_path):
    (tmp_path / "bust.zip").write_bytes(b"PK")
    for path in (tmp_path, tmp_path / "bust.zip"):
        with pytest.raises(UserError, match="unpack"):
            open_capture(path)


def test_maps_that_are_not_read_are_named_and_their_previews_are_not(tmp_path):
    with_table(tmp_path)
    ball.write(tmp_path / "envmaps/sky.png", np.zeros((8, 16, 3), np.uint8))
    assert "envmaps: left out sky.png" in said(tmp_path)
    ball.write(tmp_path / "envmaps/sky.hdr", np.ones((8, 16, 3), np.float32), "float")
    assert said(tmp_path) == ""


def test_maps_under_another_name_are_named(tmp_path):
    with_table(tmp_path)
    ball.write(tmp_path / "hdri/sky.hdr", np.ones((8, 16, 3), np.float32), "float")
    assert "hdri: holds sky.hdr: to relight with it, name the folder envmaps/" in said(tmp_path)


def test_a_light_stage_that_nothing_reads_is_named(tmp_path):
    with_table(tmp_path)
    (tmp_path / "olat").mkdir()
    directions = ball.write_stage(tmp_path / "olat", 4)
    assert "olat: holds passes of a light stage and no light table" in said(tmp_path)
    shutil.rmtree(tmp_path / "olat")
    (tmp_path / "lights.csv").write_text(ball.lights_csv(directions))
    assert "lights.csv: a light table beside views is not used" in said(tmp_path)
