"""Every public layout, written and read back: the same Stokes vectors, cameras and masks, without a capture.toml."""

import json

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.formats.images import read_mask, write_exr, write_mask

# RGBE shares one exponent: an error of 0.76 % of the pixel's largest channel, and s1 is a difference of two.
STOKES_TOLERANCE = {"pandora": 0.02}
LAYOUTS = ("phygap_mitsuba", "stokes_transforms", "pandora", "smvp3d", "rmvp3d", "angle_stack")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_stokes_layout_comes_back_as_it_was_written(layout, scene, write, tmp_path):
    getattr(write, layout)(tmp_path, scene)
    capture = open_capture(tmp_path)
    assert capture.layout == layout and capture.polarisation == "stokes"
    assert [v.view for v in capture.views] == scene.names
    for view in capture.views:
        expected = scene.stokes[view.view]
        np.testing.assert_allclose(view.read().stokes, expected, atol=STOKES_TOLERANCE.get(layout, 2e-6))
        camera, truth = capture.cameras[view.view], scene.cameras[view.view]
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-6)
        np.testing.assert_allclose(camera.intrinsics, truth.intrinsics, rtol=1e-6)
        assert (camera.width, camera.height) == (truth.width, truth.height)
        np.testing.assert_array_equal(read_mask(capture.masks[view.view]), scene.masks[view.view])


def test_colour_behind_polarisers_keeps_its_cameras_apart(scene, write, tmp_path):
    write.polarisers_transforms(tmp_path, scene)
    for i, name in enumerate(scene.names):
        write_mask(tmp_path / "masks" / "AB"[i % 2] / f"{name}.png", scene.masks[name])
    (tmp_path / "capture.toml").write_text("[polarisers.A]\nangle_deg = 20\n[polarisers.B]\nangle_deg = 97\ntrusted = false\n")
    capture = open_capture(tmp_path)
    assert capture.polarisation == "polarisers" and capture.camera_names == ("A", "B")
    assert [v.view for v in capture.views] == ["A_0000", "A_0002", "B_0001"]
    assert capture.polarisers["A"].trusted and not capture.polarisers["B"].trusted
    np.testing.assert_allclose(capture.view("B_0001").read().rgb, scene.intensity("0001", 100.0), atol=1e-6)
    for view in capture.views:
        name = view.view[2:]
        np.testing.assert_allclose(capture.cameras[view.view].world_to_camera, scene.cameras[name].world_to_camera, atol=1e-6)
        np.testing.assert_array_equal(read_mask(capture.masks[view.view]), scene.masks[name])


def test_two_colmap_folders_are_two_polarisers_in_one_world(scene, write, tmp_path):
    write.two_camera(tmp_path, scene)
    capture = open_capture(tmp_path)
    assert capture.layout == "phygap_two_camera" and capture.camera_names == ("lp0", "lp1")
    assert len(capture.views) == 6 and len(capture.masks) == 6
    np.testing.assert_allclose(capture.view("lp1_0002").read().rgb, scene.intensity("0002", 100.0), atol=1e-6)
    pose = capture.cameras["lp1_0002"]
    np.testing.assert_allclose(pose.world_to_camera, scene.cameras["0002"].world_to_camera, atol=1e-9)
    assert pose.name == "lp1"
    (tmp_path / "capture.toml").write_text("[radiometry]\nexposure_s = { lp1_0002 = 0.5 }\n")
    twice = open_capture(tmp_path).view("lp1_0002").read().rgb
    np.testing.assert_allclose(twice, 2 * scene.intensity("0002", 100.0), atol=1e-6)


def test_an_unknown_folder_is_told_what_was_looked_for_and_found(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing here")
    with pytest.raises(Exception, match=r"notes\.txt.*phygap_mitsuba.*transforms\.json"):
        open_capture(tmp_path)


def test_stacks_and_their_masks_behind_transforms(scene, write, tmp_path):
    """Pixels and cameras are found independently: a frame may name the view that a stack's files begin with."""
    write.angle_stack(tmp_path, scene)
    frames = [write.frame(scene.cameras[n], f"images/{n}") for n in scene.names]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    capture = open_capture(tmp_path)
    assert capture.layout == "stack_transforms" and capture.polarisation == "stokes" and not capture.warnings
    np.testing.assert_allclose(capture.view("0001").read().stokes, scene.stokes["0001"], atol=2e-6)
    np.testing.assert_array_equal(read_mask(capture.masks["0001"]), scene.masks["0001"])
    np.testing.assert_allclose(capture.cameras["0001"].world_to_camera, scene.cameras["0001"].world_to_camera, atol=1e-9)


def test_alpha_is_the_mask_where_every_image_has_it(scene, write, tmp_path):
    for name in scene.names:
        rgb = scene.intensity(name, 0)
        channels = {c: rgb[..., k] for k, c in enumerate("RGB")} | {"A": scene.masks[name].astype(np.float32)}
        write_exr(tmp_path / "images" / f"{name}.exr", channels)
    write.colmap_text(tmp_path / "sparse", {f"{n}.exr": c for n, c in scene.cameras.items()})
    capture = open_capture(tmp_path)
    assert capture.masks == "alpha" and capture.colmap is not None
    np.testing.assert_array_equal(capture.view("0002").read().alpha > 0.5, scene.masks["0002"])
