"""Whatever can be wrong with a capture is reported in one line that names the file, or read soundly with a warning."""

import json
import shutil

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.capture.config import load_config
from pipeline.errors import UserError
from pipeline.formats.images import write_exr, write_mask, write_png, write_stokes


def edit(path, change):
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))


def refused(root, *words, view=None):
    """The UserError of opening (and reading `view`), which is one line and names these words."""
    with pytest.raises(UserError) as caught:
        capture = open_capture(root)
        if view is not None:
            capture.view(view).read()
    line = str(caught.value)
    assert "\n" not in line
    for word in words:
        assert word in line, line
    return line


def test_missing_and_empty_folders(tmp_path):
    refused(tmp_path / "nowhere", "nowhere", "no such folder")
    refused(tmp_path, "the folder is empty")


def test_unknown_keys_and_values_of_capture_toml_are_named(scene, write, tmp_path):
    write.stokes_transforms(tmp_path, scene)
    for text, words in {
        "colour = 3": ("capture.toml", "unknown key colour"),
        "[radiometry]\nblak_level = 3": ("unknown key radiometry.blak_level", "black_level"),
        "[stokes]\nscale = 'two'": ("stokes.scale", "a number"),
        "up = 'w'": ("up = 'w'",),
        "[polarisers.left]\nangle_deg = 3": ("polarisers.left", "no camera has this name"),
        "up = ": ("not valid TOML",),
    }.items():
        (tmp_path / "capture.toml").write_text(text)
        if "polarisers" in text:
            edit(tmp_path / "transforms.json", lambda t: [f.update(camera="right") for f in t["frames"]])
            for name in scene.names:
                rgb = scene.intensity(name, 0)
                write_exr(tmp_path / "images" / f"{name}.exr", {c: rgb[..., i] for i, c in enumerate("RGB")})
        refused(tmp_path, *words)


def test_damaged_images_are_named(scene, write, tmp_path):
    write.stokes_transforms(tmp_path, scene)
    path = tmp_path / "images" / "0001.exr"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    refused(tmp_path, "0001.exr", "truncated", view="0001")
    path.write_bytes(b"this is no EXR")
    refused(tmp_path, "0001.exr", "cannot be read as an image")
    path.write_bytes(b"")
    refused(tmp_path, "0001.exr", "0 bytes")


def test_camera_without_image_and_image_without_camera_are_left_out_aloud(scene, write, tmp_path):
    write.stokes_transforms(tmp_path, scene)
    (tmp_path / "images" / "0001.exr").rename(tmp_path / "images" / "stray.exr")
    capture = open_capture(tmp_path)
    assert [v.view for v in capture.views] == ["0000", "0002"]
    text = " ".join(capture.warnings)
    assert "no image for 1 camera" in text and "0001.exr" in text and "no camera for 1 image" in text and "stray.exr" in text
    (tmp_path / "images" / "0000.exr").unlink()
    (tmp_path / "images" / "0002.exr").unlink()
    refused(tmp_path, "transforms.json", "none of its 3 images")


def test_mitsuba_camera_count_must_fit(scene, write, tmp_path):
    write.phygap_mitsuba(tmp_path, scene)
    (tmp_path / "images_full" / "0001.exr").unlink()
    capture = open_capture(tmp_path)
    assert [v.view for v in capture.views] == ["0000", "0002"] and "no image for 1 camera" in capture.warnings[0]
    np.testing.assert_allclose(capture.cameras["0002"].world_to_camera, scene.cameras["0002"].world_to_camera)
    (tmp_path / "images_full" / "0000.exr").rename(tmp_path / "images_full" / "left.exr")
    refused(tmp_path, "camera_params.npz", "3 cameras for 2 images")


def test_mask_of_another_size(scene, write, tmp_path):
    write.stokes_transforms(tmp_path, scene)
    write_mask(tmp_path / "masks" / "0001.png", np.ones((10, 12), bool))
    refused(tmp_path, "0001.png", "12x10", "32x24")


def test_image_of_another_size_than_its_camera(scene, write, tmp_path):
    write.stokes_transforms(tmp_path, scene)
    write_stokes(tmp_path / "images" / "0001.exr", scene.stokes["0001"].swapaxes(0, 1))
    refused(tmp_path, "0001.exr", "24x32", "32x24")


def test_mixed_sizes_keep_their_own_cameras(scene, write, tmp_path):
    write.stokes_transforms(tmp_path, scene)
    write_stokes(tmp_path / "images" / "0001.exr", scene.stokes["0001"][:12, :16])
    write_mask(tmp_path / "masks" / "0001.png", scene.masks["0001"][:12, :16])
    edit(tmp_path / "transforms.json", lambda t: t["frames"][1].update(w=16, h=12))
    capture = open_capture(tmp_path)
    assert capture.cameras["0001"].width == 16 and capture.cameras["0000"].width == 32


def test_two_files_of_one_view_name(scene, write, tmp_path):
    write_png(tmp_path / "images" / "a.png", np.zeros((8, 8, 3), np.uint8))
    write_exr(tmp_path / "images" / "a.exr", {c: np.zeros((8, 8)) for c in "RGB"})
    refused(tmp_path, "same view name 'a'", "a.exr", "a.png")
    (tmp_path / "images" / "a.exr").unlink()
    write_png(tmp_path / "images" / "b_c.png", np.zeros((8, 8, 3), np.uint8))
    write_png(tmp_path / "images" / "b" / "c.png", np.zeros((8, 8, 3), np.uint8))
    refused(tmp_path, "same view name 'b_c'")


def test_unicode_spaces_and_brackets_in_names(scene, write, tmp_path):
    root = tmp_path / "Büste (alt) [1]"
    write.stokes_transforms(root, scene)
    name = "Aufnahme ü 01 [b]"
    (root / "images" / "0001.exr").rename(root / "images" / f"{name}.exr")
    edit(root / "transforms.json", lambda t: t["frames"][1].update(file_path=f"images/{name}.exr"))
    capture = open_capture(root)
    np.testing.assert_allclose(capture.view(name).read().stokes, scene.stokes["0001"], atol=1e-6)


def test_pixels_that_are_not_finite_are_filled_and_marked(scene, write, tmp_path):
    write.stokes_transforms(tmp_path, scene)
    broken = scene.stokes["0001"].copy()
    broken[5, 6], broken[9, 9, 0, 1] = np.nan, np.inf
    write_stokes(tmp_path / "images" / "0001.exr", broken)
    view = open_capture(tmp_path).view("0001").read()
    assert np.isfinite(view.stokes).all()
    assert view.saturated[5, 6] and view.saturated[9, 9] and view.saturated.sum() == 2
    assert list(view.faults.values()) == [2]
    write_stokes(tmp_path / "images" / "0001.exr", np.full_like(broken, np.nan))
    refused(tmp_path, "0001.exr", "no finite pixel", view="0001")


def test_eight_bit_and_rotated_pictures_are_reported(tmp_path):
    from PIL import Image

    (tmp_path / "images").mkdir()
    tags = Image.Exif()
    tags[274] = 6
    Image.fromarray(np.full((20, 30, 3), 188, np.uint8)).save(tmp_path / "images" / "a.jpg", exif=tags, quality=95)
    view = open_capture(tmp_path).views[0].read()
    assert view.rgb.shape == (20, 30, 3)  # as the sensor saw it
    assert abs(float(view.rgb.mean()) - 0.503) < 0.01  # sRGB decoded
    text = " ".join(view.faults)
    assert "EXIF rotation 6" in text and "8 bits" in text


def test_malformed_cameras_are_named(scene, write, tmp_path):
    write.stokes_transforms(tmp_path, scene)
    edit(tmp_path / "transforms.json", lambda t: t["frames"][2].pop("transform_matrix"))
    refused(tmp_path, "transforms.json", "0002.exr", "transform_matrix")
    (tmp_path / "transforms.json").write_text("{")
    refused(tmp_path, "transforms.json", "not valid JSON")
    (tmp_path / "transforms.json").write_text('{"frames": []}')
    refused(tmp_path, "transforms.json", "no frames")


def test_an_incomplete_stack_is_named(scene, write, tmp_path):
    write.angle_stack(tmp_path, scene)
    (tmp_path / "images" / "0001_045.exr").unlink()
    (tmp_path / "images" / "0001_090.exr").unlink()
    refused(tmp_path, "0001", "only the angles 0°, 135°")


def test_missing_stokes_part_is_named(scene, write, tmp_path):
    write.pandora(tmp_path, scene)
    (tmp_path / "images_stokes" / "0002_s0p1.hdr").unlink()
    refused(tmp_path, "0002_s0p1.hdr", "is missing")


def test_truncated_files_say_one_line_and_no_library_says_another(tmp_path, capfd):
    noise = np.random.default_rng(0).integers(0, 255, (40, 40, 3)).astype(np.uint8)
    path = tmp_path / "images" / "a.png"
    write_png(path, noise)
    open_capture(tmp_path).views[0].read()
    path.write_bytes(path.read_bytes()[:2000])
    refused(tmp_path, "a.png", "truncated")
    assert capfd.readouterr().err == ""


def test_pictures_that_nobody_reads_are_named_beside_those_that_are_read(tmp_path):
    write_png(tmp_path / "images" / "a.png", np.full((16, 16, 3), 99, np.uint8))
    (tmp_path / "images" / "A001.R3D").write_bytes(b"RED2")
    (line,) = open_capture(tmp_path).warnings
    assert "A001.R3D" in line and "EXR" in line


NAN_AND_INF = [
    "olat.irradiance", "olat.specular_factor", "stokes.rotate_deg", "stokes.scale", "unit_m", "radiometry.white_level",
    "radiometry.black_level", "radiometry.saturation", "stack.zero_deg", "poses.focal_px", "poses.marker_length",
    "polarisers.a.angle_deg", "stack.angles_deg._a", "radiometry.exposure_s.a",
]  # fmt: skip


@pytest.mark.parametrize("key", [*NAN_AND_INF, "radiometry.white_balance[]", "mosaic.order[]"])
@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_settings_that_are_not_finite_are_refused(tmp_path, key, value):
    name, is_list = key.removesuffix("[]"), key.endswith("[]")
    (tmp_path / "capture.toml").write_text(f"{name} = [1.0, {value}, 2.0]\n" if is_list else f"{name} = {value}\n")
    with pytest.raises(UserError, match=rf"capture\.toml: {name.replace('.', '[.]')}.* = -?(nan|inf) is not .*number"):
        load_config(tmp_path)


@pytest.mark.parametrize(
    ("line", "word"),
    [("raw.width = 0", "raw.width"), ("raw.height = 2.5", "raw.height"), ("raw.width = true", "raw.width"),
     ("radiometry = { black_level = 64, white_level = 64 }", "radiometry.white_level"),
     ("olat.specular_factor = 0", "specular_factor"),
     *((f"{key} = {value}", key) for key in ("stokes.scale", "radiometry.exposure_s.a") for value in ("1e308", "1e-50", "-1")),
     ("olat.irradiance = 1" + "0" * 400, "olat.irradiance")],
)  # fmt: skip
def test_settings_without_meaning_are_refused(tmp_path, line, word):
    (tmp_path / "capture.toml").write_text(line + "\n")
    with pytest.raises(UserError, match=rf"capture\.toml: .*{word}"):
        load_config(tmp_path)


def test_an_ideal_polariser_may_have_infinite_extinction(tmp_path):
    (tmp_path / "capture.toml").write_text("polarisers.a.extinction = inf\n")
    assert load_config(tmp_path).polarisers["a"].extinction == float("inf")


def test_radiometry_that_a_layout_does_not_use_is_refused(tmp_path, scene, write):
    write.smvp3d(tmp_path, scene)
    (tmp_path / "capture.toml").write_text("radiometry.black_level = 64\n")
    with pytest.raises(UserError, match=r"capture\.toml: radiometry\.black_level is not used"):
        open_capture(tmp_path)
    (tmp_path / "capture.toml").write_text("")
    assert open_capture(tmp_path).layout == "smvp3d"


@pytest.mark.parametrize("key", ["dark_frame", "flat_field"])
def test_reference_frames_that_are_not_there_are_named(tmp_path, scene, write, key):
    write.angle_stack(tmp_path, scene)
    (tmp_path / "capture.toml").write_text(f'radiometry.{key} = "nowhere.tif"\n')
    with pytest.raises(UserError, match=rf"capture\.toml: radiometry\.{key} = 'nowhere\.tif' is not there"):
        open_capture(tmp_path)


def test_two_pictures_of_one_view_name_are_refused_in_every_layout(tmp_path, scene, write):
    write.phygap_mitsuba(tmp_path, scene)
    table = dict(np.load(tmp_path / "camera_params.npz"))
    np.savez(tmp_path / "camera_params.npz", **{**table, "extrinsics": table["extrinsics"][[0, 1, 2, 0]]})
    first = min((tmp_path / "images_full").glob("*.exr"))
    (tmp_path / "images_full" / "more").mkdir()
    shutil.copyfile(first, tmp_path / "images_full" / "more" / first.name)
    with pytest.raises(UserError, match=rf"{first.name}: has the same view name"):
        open_capture(tmp_path)
