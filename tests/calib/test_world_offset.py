"""Coordinates too large for float32 are kept by an offset that every file tells; others are written as they are."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.formats.images import write_stokes
from pipeline.formats.ply import Ply, write_ply
from pipeline.geometry.cameras import Camera, frame_of, load_cameras, world_offset
from pipeline.geometry.world_offset import less, offset_of, offset_told, ply_comment
from stages.calib.poses.write import write_sparse

UTM = np.array([450_000.25, 5_200_000.5, 120.0])


def ring(shift, scale=1.0, focal=90.0, count=8):
    out = {}
    for k in range(count):
        a = 2 * np.pi * k / count
        centre = 5 * scale * np.array([np.cos(a), 0.2, np.sin(a)])
        z = -centre / np.linalg.norm(centre)
        x = np.cross(z, [0, 1, 0])
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([x, np.cross(z, x), z])
        pose[:3, 3] = -pose[:3, :3] @ (centre + shift)
        out[f"{k:03d}"] = Camera(24, 20, focal, focal, 12.0, 10.0, pose)
    return out


@pytest.mark.parametrize(("shift", "scale"), [(0, 1), (1, 1), (100, 1), (3000, 100), (0, 1e-3), (0, 1e4), (1e3, 1)])
def test_ordinary_coordinates_stay_as_they_are(shift, scale):
    assert not offset_of(ring(np.full(3, float(shift)), scale)).any()


@pytest.mark.parametrize(("shift", "scale"), [(UTM, 1), (UTM, 100), (np.full(3, 1e7), 10), (np.array([0, -6.4e6, 0]), 1)])
def test_large_coordinates_get_an_offset_near_the_object(shift, scale):
    cameras = ring(np.asarray(shift, float), scale)
    offset = offset_of(cameras)
    assert np.abs(offset - shift).max() <= 5 * scale
    for camera in cameras.values():
        near = less(camera, offset)
        np.testing.assert_allclose(near.centre + offset, camera.centre, atol=1e-8)
        point = np.asarray(shift) + 0.3 * scale
        np.testing.assert_allclose(near.project(point - offset)[0], camera.project(point)[0], atol=1e-5)


def test_the_rule_is_the_pixels_footprint():
    """A longer lens sees finer and needs the offset earlier."""
    cameras = ring(np.full(3, 4e3))
    assert not offset_of(cameras).any()
    assert offset_of({n: replace(c, fx=3000.0, fy=3000.0) for n, c in cameras.items()}).any()


def capture(root, shift):
    frames = []
    for name, camera in ring(shift).items():
        write_stokes(root / "images" / f"{name}.exr", np.full((20, 24, 3, 3), [[0.5], [0.1], [0.0]], np.float32))
        frames.append({"file_path": f"images/{name}.exr", **frame_of(camera)})
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))


def test_poses_writes_near_coordinates_and_tells_the_offset_in_every_file(run_stages, tmp_path):
    capture(tmp_path / "far", UTM)
    capture(tmp_path / "near", np.zeros(3))
    points = np.array([[1.0, 2, 3], [4, 5, 6]])
    write_sparse(tmp_path / "model", ring(UTM), points + UTM)
    far, near = (run_stages(tmp_path / n, tmp_path / f"{n}.d", "decode", "poses")["poses"].output for n in ("far", "near"))
    offset = world_offset(far / "cameras.json")
    assert offset.any() and not world_offset(near / "cameras.json").any()
    assert "world_offset" not in json.loads((near / "cameras.json").read_text())
    for view, camera in load_cameras(far / "cameras.json").items():
        np.testing.assert_allclose(camera.centre + offset, ring(UTM)[view].centre, atol=1e-8)
    assert "# offset 450000.0 5200000.0 120.0" in (far / "sparse/images.txt").read_text()
    assert "offset" not in (near / "sparse/images.txt").read_text()


def test_points_of_a_given_model_are_brought_near(run_stages, tmp_path):
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    root = tmp_path / "c"
    capture(root, UTM)
    (root / "transforms.json").unlink()
    write_sparse(root / "sparse/0", ring(UTM), points + UTM, suffix=".exr")
    poses = run_stages(root, tmp_path / "d", "decode", "poses")["poses"].output
    from stages.train.initialise.points import read_points

    offset = offset_told(poses / "points.ply")
    assert offset.tolist() == world_offset(poses / "cameras.json").tolist() and offset.any()
    np.testing.assert_allclose(read_points(poses / "points.ply") + offset, points + UTM, atol=1e-6)


def test_a_mesh_tells_its_offset_only_where_it_has_one(tmp_path):
    columns, faces = dict(zip("xyz", np.array([[0, 1, 0], [0, 0, 1], [0, 0, 0.0]]))), np.array([[0, 1, 2]])
    write_ply(tmp_path / "a.ply", columns, faces, comments=ply_comment(UTM))
    write_ply(tmp_path / "b.ply", columns, faces, comments=ply_comment(np.zeros(3)))
    assert Ply(tmp_path / "a.ply").triangles().tolist() == [[0, 1, 2]]
    assert offset_told(tmp_path / "a.ply").tolist() == UTM.tolist() and not offset_told(tmp_path / "b.ply").any()
    assert b"comment" not in (tmp_path / "b.ply").read_bytes()


def test_cameras_json_and_sparse_name_files_that_are_there(run_stages, tmp_path):
    capture(tmp_path / "c", np.zeros(3))
    poses = run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses")["poses"].output
    table = json.loads((poses / "cameras.json").read_text())
    lines = [x for x in (poses / "sparse/images.txt").read_text().splitlines() if x and not x.startswith("#")]
    assert len(lines) == len(table["frames"]) == 8
    for frame, line in zip(table["frames"], lines):
        assert (poses / frame["file_path"]).is_file() and frame["file_path"].endswith(f"{frame['view']}.exr")
        assert line.split()[-1] == f"{frame['view']}.exr"
