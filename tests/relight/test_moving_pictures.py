"""Turntables hold all of the mesh; paths of cameras come from files that people have; pictures move as WebP and MP4."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.geometry.cameras import Camera, camera_from_opengl, opengl_from_camera, save_cameras
from stages.relight.camera_path import in_world, read_camera_path
from stages.relight.orbit import orbit
from stages.relight.video import write_mp4, write_webp
from synth.orbit import look_at
from synth.orbit import orbit as positions


def camera(position, size: int = 32, focal: float = 40.0) -> Camera:
    return Camera(size, size, focal, focal, size / 2, size / 2, camera_from_opengl(look_at(np.asarray(position, float))))


@pytest.mark.parametrize("up", ["y", "z", "-x"])
@pytest.mark.parametrize("near", [1.2, 40.0])
def test_an_orbit_shows_all_of_the_mesh_however_near_the_capture_was_taken(up, near):
    vertices = np.random.default_rng(0).normal(size=(500, 3)) * [1.0, 2.5, 0.6] + [5, -2, 1]
    cameras = {f"{k}": camera(p * near + [5, -2, 1]) for k, p in enumerate(positions(3, 1.0, 10, 40))}
    frames = orbit(cameras, vertices, up, 12, 64)
    reach = []
    for frame in frames:
        pixels, depth = frame.project(vertices)
        assert depth.min() > 0 and pixels.min() > 0 and pixels.max() < 64
        reach.append(np.abs(pixels - 32).max())
    assert max(reach) == pytest.approx(0.94 * 32, rel=1e-6)  # and as large as that allows


def test_cameras_of_transforms_json_and_of_our_own_file_keep_their_order_and_world(tmp_path):
    one, two = camera([3.0, 1, 2]), camera([-2.0, 2, 2])
    save_cameras(tmp_path / "cameras.json", {"a": one, "b": two}, offset=np.array([100.0, 0, 0]))
    path = read_camera_path(tmp_path / "cameras.json")
    assert np.allclose(path.cameras[0].centre, one.centre + np.array([100.0, 0, 0]))
    assert np.allclose(in_world(path, np.array([100.0, 0, 0])).cameras[1].centre, two.centre)

    matrix = opengl_from_camera(one.world_to_camera).tolist()
    table = {"w": 40, "h": 30, "fl_x": 50, "frames": [{"transform_matrix": matrix}], "fps": 12}
    (tmp_path / "transforms.json").write_text(json.dumps(table))
    path = read_camera_path(tmp_path / "transforms.json")
    assert (path.cameras[0].width, path.cameras[0].cx, path.frames_per_second) == (40, 20, 12)


def test_a_camera_path_of_nerfstudio_has_its_vertical_field_of_view(tmp_path):
    matrix = opengl_from_camera(camera([0.0, 0, 4]).world_to_camera).ravel().tolist()
    table = {"camera_path": [{"camera_to_world": matrix, "fov": 90}], "render_height": 30, "render_width": 40, "fps": 30}
    (tmp_path / "path.json").write_text(json.dumps(table))
    found = read_camera_path(tmp_path / "path.json").cameras[0]
    assert (found.fx, found.fy) == pytest.approx((15, 15)) and np.allclose(found.centre, [0, 0, 4])


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ([], "no table"),
        ({"frames": []}, "no cameras"),
        ({"camera_path": [{"fov": 50}], "render_height": 8, "render_width": 8}, "camera_to_world"),
        ({"frames": [{"transform_matrix": np.eye(4).tolist()}]}, "fl_x"),
        ({"fps": "fast", "w": 8, "h": 8, "fl_x": 8, "frames": [{"transform_matrix": np.eye(4).tolist()}]}, "fps"),
    ],
)
def test_a_file_that_is_no_path_is_refused(tmp_path, table, said):
    (tmp_path / "path.json").write_text(json.dumps(table))
    with pytest.raises(UserError, match=said):
        read_camera_path(tmp_path / "path.json")


@pytest.fixture
def frames():
    rows, columns = np.mgrid[:33, :49]
    return [np.stack([rows * 7, columns * 5, np.full_like(rows, 60 * k)], -1).astype(np.uint8) for k in range(3)]


@pytest.mark.skipif(not shutil.which("ffmpeg"), reason="no ffmpeg")
def test_mp4_holds_every_frame_in_its_colours(tmp_path, frames):
    assert write_mp4(tmp_path / "a.mp4", frames, 16)
    raw = ["ffmpeg", "-loglevel", "error", "-i", tmp_path / "a.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    shown = np.frombuffer(subprocess.run(raw, capture_output=True, check=True).stdout, np.uint8).reshape(3, 32, 48, 3)
    want = np.stack(frames)[:, :32, :48]
    assert np.abs(shown.astype(int) - want).mean() < 4  # colour at half the resolution, quality 18


def test_without_ffmpeg_there_is_no_mp4_and_no_fault(tmp_path, frames, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not write_mp4(tmp_path / "a.mp4", frames, 16)
    write_webp(tmp_path / "a.webp", [*frames, frames[0][:20]], 16)  # of another size: scaled
    assert (tmp_path / "a.webp").stat().st_size > 100 and not (tmp_path / "a.mp4").exists()
