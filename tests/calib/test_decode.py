"""The decode stage: frames as written by a capture, facts per view, warnings once per kind."""

import json

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.images import read_exr, read_mask, read_stokes, write_exr, write_stokes
from pipeline.geometry.cameras import Camera, opengl_from_camera


def capture_of(root, images, channels):
    """A transforms.json capture of EXR images."""
    camera = Camera(images[0].shape[1], images[0].shape[0], 50.0, 50.0, 16.0, 12.0, np.eye(4))
    frames = []
    for i, image in enumerate(images):
        if channels == "stokes":
            write_stokes(root / "images" / f"{i:03d}.exr", image)
        else:
            write_exr(root / "images" / f"{i:03d}.exr", {c: image[..., k] for k, c in enumerate("RGB")})
        matrix = opengl_from_camera(camera.world_to_camera).tolist()
        frames.append({"file_path": f"images/{i:03d}.exr", "transform_matrix": matrix})
    table = {"fl_x": 50, "w": camera.width, "h": camera.height, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(table))


def some_stokes(seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    s0 = rng.uniform(0.1, 1.0, (24, 32, 1, 3))
    return (scale * np.concatenate([s0, 0.3 * s0, -0.2 * s0], 2)).astype(np.float32)


def frames_json(run):
    return json.loads((run.output / "frames.json").read_text())


def test_stokes_frames_keep_the_files_vectors(run_stages, tmp_path):
    images = [some_stokes(i) for i in range(3)]
    capture_of(tmp_path / "c", images, "stokes")
    run = run_stages(tmp_path / "c", tmp_path / "d", "decode")["decode"]
    table = frames_json(run)
    assert table["schema"] == 1 and table["polarisation"] == "stokes" and list(table["views"]) == ["000", "001", "002"]
    for i, (view, facts) in enumerate(table["views"].items()):
        assert (facts["width"], facts["height"], facts["camera"], facts["file"]) == (32, 24, "camera", f"frames/{view}.exr")
        np.testing.assert_allclose(read_stokes(run.output / facts["file"]), images[i], rtol=6e-4, atol=1e-6)


@pytest.mark.parametrize("scale", [1e-4, 1e5])
def test_scenes_beyond_half_floats_stay_exact(scale, run_stages, tmp_path):
    images = [some_stokes(0, scale)]
    capture_of(tmp_path / "c", images, "stokes")
    run = run_stages(tmp_path / "c", tmp_path / "d", "decode")["decode"]
    np.testing.assert_allclose(read_stokes(run.output / "frames/000.exr"), images[0], rtol=1e-6)


@pytest.mark.parametrize("samples", [(3e38, 3e38, 3e38), (1e38, 3e38, -3e38)])
def test_light_beyond_single_precision_is_refused(samples, run_stages, tmp_path):
    for angle, value in zip((0, 60, 120), samples):
        image = np.full((24, 32), value, np.float32)
        write_exr(tmp_path / "c/images" / f"a_{angle:03d}.exr", {c: image for c in "RGB"})
    with pytest.raises(UserError, match=r"a_000\.exr: its radiance is more than single precision holds; check"):
        run_stages(tmp_path / "c", tmp_path / "d", "decode")


def test_stokes_table_of_capture_toml_is_applied(run_stages, tmp_path):
    image = some_stokes()
    capture_of(tmp_path / "c", [image], "stokes")
    (tmp_path / "c" / "capture.toml").write_text("[stokes]\nscale = 0.5\nflip_s2 = true\nrotate_deg = 90\n")
    run = run_stages(tmp_path / "c", tmp_path / "d", "decode")["decode"]
    out = read_stokes(run.output / "frames/000.exr")
    expected = 0.5 * image * np.float32([1, -1, 1])[:, None]  # flipped, then turned by 90 degrees: s1 and s2 change sign
    np.testing.assert_allclose(out, expected, rtol=1e-3, atol=1e-6)


def test_clipped_float_images_are_found_and_marked(run_stages, tmp_path):
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 1.5, (24, 32, 3)).astype(np.float32)
    image[5:9, 5:9] = 2.0
    capture_of(tmp_path / "c", [image, np.minimum(image, 1.4999)], "rgb")
    run = run_stages(tmp_path / "c", tmp_path / "d", "decode")["decode"]
    views = frames_json(run)["views"]
    mask = read_mask(run.output / views["000"]["saturated"])
    assert mask[5:9, 5:9].all() and mask.sum() == 16 and views["000"]["saturated_fraction"] == pytest.approx(16 / 768)
    assert "S0.R" not in read_exr(run.output / "frames/000.exr")


def test_noise_of_a_textured_picture_is_estimated(run_stages, tmp_path):
    y, x = np.mgrid[:120, :160]
    image = np.repeat((0.5 + 0.3 * np.sin(x / 9) * (y > 50))[..., None], 3, -1)
    image = (image + np.random.default_rng(0).normal(0, 0.01, image.shape)).astype(np.float32)
    capture_of(tmp_path / "c", [image], "rgb")
    facts = frames_json(run_stages(tmp_path / "c", tmp_path / "d", "decode")["decode"])["views"]["000"]
    assert facts["noise"] == pytest.approx(0.01, rel=0.15)


def test_one_warning_for_a_fault_of_many_files(run_stages, tmp_path):
    images = [some_stokes(i) for i in range(3)]
    for image in images:
        image[0, 0, 0, 0] = np.nan
    capture_of(tmp_path / "c", images, "stokes")
    run = run_stages(tmp_path / "c", tmp_path / "d", "decode")["decode"]
    assert len(run.warnings) == 1 and "000.exr and 2 more" in run.warnings[0] and "3 pixels not finite" in run.warnings[0]


def test_stack_reports_design_and_refuses_angles_too_close(run_stages, tmp_path):
    stokes = some_stokes()
    root = tmp_path / "c"

    def write(angles):
        for name in ("a", "b"):
            for angle in angles:
                t = 2 * np.radians(angle)
                rgb = (stokes[:, :, 0] + stokes[:, :, 1] * np.cos(t) + stokes[:, :, 2] * np.sin(t)) / 2
                write_exr(root / "images" / f"{name}_{angle:03d}.exr", {c: rgb[..., k] for k, c in enumerate("RGB")})

    write((0, 45, 90, 135))
    facts = frames_json(run_stages(root, tmp_path / "d", "decode")["decode"])["views"]["a"]
    assert np.array(facts["design"]).shape == (4, 3) and facts["condition"] < 2
    for path in (root / "images").iterdir():
        path.unlink()
    write((0, 45, 90))
    (root / "capture.toml").write_text('[stack.angles_deg]\n"_000" = 0\n"_045" = 0.1\n"_090" = 90\n')
    with pytest.raises(UserError, match="too close together"):
        run_stages(root, tmp_path / "e", "decode")
