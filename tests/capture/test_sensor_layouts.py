"""Layouts whose pixels come from a sensor or a light stage, written and read back: values, cameras and masks."""

import json

import numpy as np
import pytest
import tifffile

from pipeline.capture import open_capture
from pipeline.capture.angle_stack.solve import polariser_design
from pipeline.formats.images import read_image, read_mask, write_exr, write_mask
from pipeline.geometry.cameras import opengl_from_camera

FULL = (3240, 6144)


def assert_cameras_and_masks(capture, scene):
    for view in capture.views:
        truth = scene.cameras[view.view]
        np.testing.assert_allclose(capture.cameras[view.view].world_to_camera, truth.world_to_camera, atol=1e-6)
        np.testing.assert_allclose(capture.cameras[view.view].intrinsics, truth.intrinsics, rtol=1e-6)
        np.testing.assert_array_equal(read_mask(capture.masks[view.view]), scene.masks[view.view])


@pytest.mark.parametrize(("colour", "code"), [("mono", np.uint16), ("bayer", np.uint16), ("mono", np.uint8)])
def test_mosaics_come_back_with_cameras_and_masks(colour, code, scene, write, tmp_path):
    """Even light, which any demosaicking gives back: what is held here is the frame, the order, the factor and the names."""
    (tmp_path / "images").mkdir()
    truth = {}
    for name in scene.names:
        mean = scene.stokes[name].mean((0, 1))
        truth[name] = mean if colour == "bayer" else np.repeat(mean.mean(-1, keepdims=True), 3, -1)
        red, green, blue = (polariser_design((90, 45, 135, 0)) @ truth[name]).T.reshape(3, 2, 2)
        block = np.block([[red, green], [green, blue]])
        codes = np.round(np.tile(block, (6, 8)) * np.iinfo(code).max).astype(code)
        tifffile.imwrite(tmp_path / "images" / f"{name}.tif", codes, photometric="minisblack")
    write.masks(tmp_path / "masks", scene)
    write.colmap_text(tmp_path / "sparse" / "0", {f"{n}.tif": c for n, c in scene.cameras.items()})
    (tmp_path / "capture.toml").write_text(f'[mosaic]\ncolour = "{colour}"\n')  # 24 rows are few to tell colours from
    capture = open_capture(tmp_path)
    assert capture.layout == "mosaic" and capture.polarisation == "stokes"
    for view in capture.views:
        stokes = view.read().stokes
        np.testing.assert_allclose(
            stokes, np.broadcast_to(truth[view.view], stokes.shape), atol=2.5 / np.iinfo(code).max + 4e-3
        )
    assert_cameras_and_masks(capture, scene)


def test_photographs_come_back_with_cameras_and_masks(scene, write, tmp_path):
    (tmp_path / "images").mkdir()
    for name in scene.names:
        codes = np.round(scene.intensity(name, 0) * 65535).astype(np.uint16)
        tifffile.imwrite(tmp_path / "images" / f"{name}.tif", codes, photometric="rgb")
    write.masks(tmp_path / "masks", scene)
    frames = [write.frame(scene.cameras[n], f"images/{n}.tif") for n in scene.names]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}), encoding="utf-8-sig")  # as some tools write
    capture = open_capture(tmp_path)
    assert capture.polarisation == "none"
    for view in capture.views:
        np.testing.assert_allclose(view.read().rgb, scene.intensity(view.view, 0), atol=1e-5)
    assert_cameras_and_masks(capture, scene)


@pytest.mark.parametrize("published", [True, False])
def test_a_light_stage_comes_back_as_it_was_written(published, scene, tmp_path):
    """The published frame numbers and tables (2..N+1 of N+4, a spiral through a turned table), or 0..N-1 and lights.csv."""
    rng = np.random.default_rng(0)
    lights, width, height = 11, 27, 48
    directions = rng.normal(size=(lights, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    first, count = (2, lights + 4) if published else (0, lights)
    for k in range(count):
        for name, level in (("cross", 0.25), ("parallel", 0.5)):
            pixels = {c: np.full((height, width), level * (k - first + 1) / 32, np.float32) for c in "RGB"}
            write_exr(tmp_path / "cam07" / name / f"{k:06d}.exr", pixels, half=True)
    mask = np.zeros((height, width), bool)
    mask[5:30, 4:20] = True
    write_mask(tmp_path / "cam07" / "mask.png", mask)
    pose = scene.cameras["0002"].world_to_camera
    matrix = "\n".join(" ".join(f"{v:.12f}" for v in row) for row in opengl_from_camera(pose))
    (tmp_path / "cameras").mkdir()
    (tmp_path / "cameras" / "camera07.txt").write_text(
        f"#focal length\n9000 9010\n#principal point\n1650 3100\n#resolution\n{FULL[0]} {FULL[1]}\n"
        f"#distortion coeffs\n0.43 -0.22 0 0\nMATRIX :\n{matrix}\n"
    )
    if published:
        rows = rng.permutation(lights)  # light k stands in row rows[k], turned by 180 degrees about y
        table = np.empty_like(directions)
        table[rows] = 130 * directions * [-1, 1, -1]
        np.savetxt(tmp_path / "LSX3_light_positions.txt", table)
        np.savetxt(tmp_path / "LSX3_light_z_spiral.txt", rows + 1, fmt="%d")
    else:
        lines = [f"{k},{x:.12f},{y:.12f},{z:.12f}" for k, (x, y, z) in enumerate(2.5 * directions)]
        (tmp_path / "lights.csv").write_text("\n".join(["index,x,y,z", *reversed(lines)]))
    capture = open_capture(tmp_path)
    assert capture.kind == "light_stage"
    np.testing.assert_allclose(capture.light_stage.lights.directions, directions, atol=1e-6)
    stage = capture.light_stage.cameras["cam07"]
    for k in range(lights):
        assert read_image(stage.cross[k]).max() == np.float32(0.25 * (k + 1) / 32)
        assert read_image(stage.parallel[k]).max() == np.float32(0.5 * (k + 1) / 32)
    scale = height / FULL[1]
    camera = stage.camera
    np.testing.assert_allclose(camera.world_to_camera, pose, atol=1e-6)
    np.testing.assert_allclose([camera.fx, camera.fy], [9000 * scale, 9010 * scale], rtol=1e-6)
    np.testing.assert_allclose([camera.cx, camera.cy], [width / 2 + (1650 - 1620) * scale, 3100 * scale], rtol=1e-6)
    np.testing.assert_array_equal(read_mask(stage.mask), mask)
