"""Poses: given cameras in the dataset's schemas, COLMAP models read, cameras found from photographs."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.capture.assembly.camera_source import decompose
from pipeline.capture.config import PosesConfig
from pipeline.errors import UserError
from pipeline.formats.colmap import pose_matrix, read_model
from pipeline.formats.images import write_png
from pipeline.geometry.cameras import load_cameras
from stages.calib.poses.write import quaternion, write_sparse

FEW = {"features": 800, "max_size": 480}  # keeps COLMAP short


def photographs(root, images):
    for i, image in enumerate(images):
        write_png(root / "images" / f"{i:03d}.png", image)


def same_up_to_similarity(found, truth):
    """Largest rotation error (degrees) and centre error (of the spread of the centres), after the best alignment."""
    a = np.stack([c.centre for c in found])
    b = np.stack([c.centre for c in truth])
    ma, mb = a.mean(0), b.mean(0)
    u, s, vt = np.linalg.svd((b - mb).T @ (a - ma))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    scale = (s * [1, 1, np.linalg.det(u @ vt)]).sum() / ((a - ma) ** 2).sum()
    centres = np.abs(scale * (a - ma) @ turn.T + mb - b).max() / np.linalg.norm(b - mb, axis=-1).mean()
    angles = []
    for f, t in zip(found, truth):
        between = f.world_to_camera[:3, :3] @ turn.T @ t.world_to_camera[:3, :3].T
        angles.append(np.degrees(np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1))))
    return max(angles), centres


def test_quaternions_go_round_for_every_turn():
    rng = np.random.default_rng(0)
    for q in [*rng.normal(size=(50, 4)), [0, 1, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0], [1e-9, 1, 1, 0]]:
        matrix = pose_matrix(q, [0, 0, 0])[:3, :3]
        np.testing.assert_allclose(pose_matrix(quaternion(matrix), [0, 0, 0])[:3, :3], matrix, atol=1e-12)


def test_projection_matrices_fall_apart_into_camera_and_pose(corner):
    camera = corner[1][0]
    for factor in (1.0, -3.0):
        k, pose = decompose(factor * camera.intrinsics @ camera.world_to_camera[:3])
        np.testing.assert_allclose(k, camera.intrinsics, atol=1e-9)
        np.testing.assert_allclose(pose, camera.world_to_camera, atol=1e-12)


def test_colmap_text_model_goes_round(corner, tmp_path):
    cameras = {f"folder/pic {i}": c for i, c in enumerate(corner[1])}
    points = np.array([[0.5, 0.25, 1.0], [1.0, 2.0, 3.0]])
    write_sparse(tmp_path, cameras, points, np.array([[1, 2, 3], [250, 0, 9]], np.uint8))
    model = read_model(tmp_path)
    assert list(model.cameras) == sorted(cameras)
    for name, camera in cameras.items():
        np.testing.assert_allclose(model.cameras[name].world_to_camera, camera.world_to_camera, atol=1e-12)
    np.testing.assert_array_equal(model.points, points)
    (tmp_path / "images.txt").write_text("1 nonsense\n")
    with pytest.raises(UserError, match=r"images\.txt.*not a COLMAP model"):
        read_model(tmp_path)


@pytest.mark.slow
def test_existing_model_beside_photographs_is_used_as_it_is(corner, run_stages, tmp_path):
    images, cameras = corner
    photographs(tmp_path / "c", images)
    write_sparse(tmp_path / "c" / "sparse" / "0", {f"{i:03d}.png": c for i, c in enumerate(cameras)}, np.ones((5, 3)))
    capture = open_capture(tmp_path / "c")
    assert capture.colmap is not None and capture.cameras["003"].fx == 560.0
    run = run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses")["poses"]
    found = load_cameras(run.output / "cameras.json")
    for i, camera in enumerate(cameras):
        np.testing.assert_allclose(found[f"{i:03d}"].world_to_camera, camera.world_to_camera, atol=1e-9)
    assert (run.output / "points.ply").is_file() and (run.output / "sparse" / "images.txt").is_file()


@pytest.mark.slow
def test_binary_model_of_colmap_reads_like_its_text(corner, tmp_path):
    import pycolmap

    write_sparse(
        tmp_path / "text", {f"{i}.png": c for i, c in enumerate(corner[1])}, np.random.default_rng(0).normal(size=(7, 3))
    )
    (tmp_path / "binary").mkdir()
    pycolmap.Reconstruction(str(tmp_path / "text")).write_binary(str(tmp_path / "binary"))
    text, binary = read_model(tmp_path / "text"), read_model(tmp_path / "binary")
    assert sorted(binary.cameras) == sorted(text.cameras)
    for name, camera in text.cameras.items():
        np.testing.assert_allclose(binary.cameras[name].world_to_camera, camera.world_to_camera, atol=1e-12)
    np.testing.assert_allclose(np.sort(binary.points, 0), np.sort(text.points, 0))


@pytest.mark.slow
def test_cameras_are_found_from_photographs_and_twice_the_same(corner, run_stages, tmp_path):
    images, cameras = corner
    photographs(tmp_path / "c", images)
    runs = [run_stages(tmp_path / "c", tmp_path / name, "decode", "poses", poses=FEW) for name in ("d", "e")]
    first, second = ((r["poses"].output / "cameras.json").read_bytes() for r in runs)
    assert first == second
    facts = runs[0]["poses"].facts
    assert facts["registered"] == len(images) and facts["mean_reprojection_error_px"] < 0.7
    assert facts["focal_px"]["camera"] == pytest.approx(560, rel=0.03)
    found = load_cameras(runs[0]["poses"].output / "cameras.json")
    angle, centre = same_up_to_similarity([found[v] for v in sorted(found)], cameras)
    assert angle < 1.0 and centre < 0.05


@pytest.mark.slow
def test_a_known_distance_sets_the_scale_and_a_known_focal_length_is_kept(corner, run_stages, tmp_path):
    images, cameras = corner
    photographs(tmp_path / "c", images)
    distance = float(np.linalg.norm(cameras[0].centre - cameras[6].centre))
    toml = f'[poses]\nfocal_px = 560\nscale_pair = ["000", "006"]\nscale_distance = {distance}\n'
    (tmp_path / "c" / "capture.toml").write_text(toml)
    found = load_cameras(
        run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses", poses=FEW)["poses"].output / "cameras.json"
    )
    assert np.linalg.norm(found["000"].centre - found["006"].centre) == pytest.approx(distance, rel=1e-6)
    assert found["000"].fx == 560.0


@pytest.mark.slow
def test_marker_of_known_length_sets_the_scale(corner, corner_scene, tmp_path):
    from stages.calib.poses.scale import world_scale

    pictures = {f"{i:03d}": tmp_path / f"{i:03d}.png" for i in range(len(corner[0]))}
    for (_, path), image in zip(sorted(pictures.items()), corner[0]):
        write_png(path, image)
    cameras = dict(zip(sorted(pictures), corner[1]))
    settings = PosesConfig(marker_length=0.05)
    assert world_scale(settings, cameras, pictures, tmp_path) == pytest.approx(0.05 / corner_scene.marker_side, rel=0.02)
    with pytest.raises(UserError, match=r"no marker of 5X5_50.*two or more views"):
        world_scale(PosesConfig(marker_length=0.05, marker_dictionary="5X5_50"), cameras, pictures, tmp_path)
    with pytest.raises(UserError, match=r"marker_dictionary = 'QR'"):
        world_scale(PosesConfig(marker_length=0.05, marker_dictionary="QR"), cameras, pictures, tmp_path)


@pytest.mark.slow
def test_two_pictures_of_one_name_are_a_head_with_one_relative_pose(corner_scene, run_stages, tmp_path):
    """Cameras A and B turn together about the corner, B a hand's breadth beside A."""
    base = [corner_scene.camera(25 + 6 * i, 0.05 * (i % 3)) for i in range(6)]
    beside = np.eye(4)
    beside[:3, 3] = [-0.35, 0.02, 0.0]
    frames = {"A": base, "B": [replace(c, world_to_camera=beside @ c.world_to_camera) for c in base]}
    for name, cameras in frames.items():
        for i, camera in enumerate(cameras):
            write_png(tmp_path / "c" / "images" / name / f"{i:03d}.png", corner_scene.picture(camera))
    toml = "[polarisers.A]\nangle_deg = 0\ntrusted = false\n[polarisers.B]\nangle_deg = 60\ntrusted = false\n"
    (tmp_path / "c" / "capture.toml").write_text(toml)
    run = run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses", poses=FEW)["poses"]
    assert len(run.facts["rig"]) == 2 and run.facts["registered"] == 12
    found = load_cameras(run.output / "cameras.json")
    assert {c.name for c in found.values()} == {"A", "B"}
    between = [
        found[f"B_{i:03d}"].world_to_camera @ np.linalg.inv(found[f"A_{i:03d}"].world_to_camera) for i in range(len(base))
    ]
    for pose in between[1:]:
        np.testing.assert_allclose(pose, between[0], atol=1e-9)
    direction = between[0][:3, 3] / np.linalg.norm(between[0][:3, 3])
    assert direction @ (beside[:3, 3] / np.linalg.norm(beside[:3, 3])) > np.cos(np.radians(3))


def test_too_few_views_and_featureless_views_say_what_to_try(run_stages, tmp_path):
    photographs(tmp_path / "two", [np.full((40, 40, 3), 99, np.uint8)] * 2)
    with pytest.raises(UserError, match="2 views without cameras"):
        run_stages(tmp_path / "two", tmp_path / "d", "decode", "poses")
    photographs(tmp_path / "flat", [np.full((64, 64, 3), 99, np.uint8)] * 4)
    with pytest.raises(UserError, match=r"too few features.*overlap"):
        run_stages(tmp_path / "flat", tmp_path / "e", "decode", "poses")


@pytest.mark.slow
def test_given_cameras_can_be_triangulated(corner, run_stages, tmp_path):
    images, cameras = corner
    photographs(tmp_path / "c", images)
    write_sparse(tmp_path / "c" / "sparse" / "0", {f"{i:03d}.png": c for i, c in enumerate(cameras)})
    runs = run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses", poses={"triangulate": True, **FEW})
    assert runs["poses"].facts["points"] > 100
    data = (runs["poses"].output / "points.ply").read_bytes()
    cloud = np.frombuffer(data[data.index(b"end_header\n") + 11 :], [("xyz", "<f4", 3), ("rgb", "u1", 3)])["xyz"]
    on_a_plane = np.abs(cloud).min(1)  # the corner's planes are x = 0, y = 0 and z = 0
    assert np.median(on_a_plane) < 0.02
