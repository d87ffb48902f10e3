"""Camera conventions: OpenCV inside, pixel centres at +0.5, the Stokes frame follows each pixel's ray and the roll."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.geometry.cameras import Camera, camera_from_opengl, load_cameras, opengl_from_camera, save_cameras
from pipeline.geometry.lens_models import MODELS


def looking_at_origin(roll_deg: float = 0.0) -> Camera:
    angle = np.radians(roll_deg)
    roll = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    pose = np.eye(4)
    pose[:3, :3] = roll @ np.diag([1.0, -1.0, -1.0])  # y up in the world, camera on +z looking back
    pose[:3, 3] = [0, 0, 5]
    return Camera(60, 40, 50.0, 50.0, 30.0, 20.0, pose, name="lp0")


def test_rays_and_projection_agree_with_pixel_centres_at_half():
    camera = looking_at_origin(20)
    pixels, depth = camera.project(camera.centre + 3.0 * camera.rays())
    u, v = np.meshgrid(np.arange(60) + 0.5, np.arange(40) + 0.5)
    np.testing.assert_allclose(pixels, np.stack([u, v], -1), atol=1e-9)
    assert (depth > 0).all()


def test_opengl_matrices_round_trip_and_files_keep_cameras(tmp_path):
    camera = looking_at_origin(33)
    np.testing.assert_allclose(camera_from_opengl(opengl_from_camera(camera.world_to_camera)), camera.world_to_camera,
                               atol=1e-12)  # fmt: skip
    save_cameras(tmp_path / "cameras.json", {"view": camera})
    back = load_cameras(tmp_path / "cameras.json")["view"]
    np.testing.assert_allclose(back.world_to_camera, camera.world_to_camera, atol=1e-12)
    assert back.name == "lp0" and back.intrinsics.tolist() == camera.intrinsics.tolist()


@pytest.mark.parametrize("lens", sorted(MODELS))
def test_files_keep_every_coefficient_of_every_lens(tmp_path, lens):
    names = MODELS[lens].names
    coefficients = tuple(0.01 * (k + 1) for k in range(len(names)))
    camera = replace(looking_at_origin(), lens=lens, distortion=coefficients)
    if lens == "EQUIRECTANGULAR":
        camera = replace(camera, fx=60 / (2 * np.pi), fy=40 / np.pi)
    if lens == "OPENCV":
        camera = replace(camera, distortion=(0.1, 0.0, 0.0, 0.2))
    save_cameras(tmp_path / "cameras.json", {"a": camera})
    back = load_cameras(tmp_path / "cameras.json")["a"]
    assert (back.lens, back.distortion) == (lens, camera.distortion)
    seen = back.rays_at(np.array([[30.0, 20.0], [35.0, 17.0]]))
    np.testing.assert_allclose(camera.pixels_of(seen), [[30, 20], [35, 17]], atol=1e-8)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda f: f.update(fl_x=-5.0), "above 0"),
        (lambda f: f.update(transform_matrix=np.zeros((4, 4)).tolist()), "rotation"),
        (lambda f: f.update(transform_matrix=(2 * np.eye(4)).tolist()), "rotation"),
        (lambda f: f.update(transform_matrix=np.diag([1.0, 1, -1, 1]).tolist()), "rotation"),
        (lambda f: f["transform_matrix"][0].__setitem__(3, float("nan")), "finite"),
    ],
)
def test_a_camera_that_can_be_none_is_refused_by_frame(tmp_path, change, word):
    path = tmp_path / "cameras.json"
    save_cameras(path, {"view7": looking_at_origin()})
    table = json.loads(path.read_text())
    change(table["frames"][0])
    path.write_text(json.dumps(table))
    with pytest.raises(UserError, match=f"view7.*{word}"):
        load_cameras(path)


def test_the_stokes_frame_is_right_and_up_across_each_ray_and_turns_with_the_camera():
    camera = looking_at_origin()
    x, y = camera.stokes_frame()
    rays = camera.rays()
    assert np.abs((x * rays).sum(-1)).max() < 1e-12 and np.abs((y * rays).sum(-1)).max() < 1e-12
    centre = (20, 30)
    np.testing.assert_allclose(x[centre], [1, 0, 0], atol=0.02)
    np.testing.assert_allclose(y[centre], [0, 1, 0], atol=0.02)
    rolled_x, _ = looking_at_origin(90).stokes_frame()
    assert abs(rolled_x[centre] @ x[centre]) < 0.05
