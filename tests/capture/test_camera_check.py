"""What can be no camera is refused before any work, in one line that names the reader's own file."""

import json
import os
import struct

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.errors import UserError
from pipeline.formats.images import write_png
from pipeline.geometry.cameras import Camera, frame_of
from pipeline.geometry.separate_worlds import two_worlds


def ring(count=9, radius=4.0, size=16, name="camera"):
    """Cameras on a ring that look at the origin."""
    out = []
    for k in range(count):
        a = 2 * np.pi * k / count
        centre = radius * np.array([np.cos(a), 0.3 * (-1) ** k, np.sin(a)])
        z = -centre / np.linalg.norm(centre)
        x = np.cross(z, [0, 1, 0])
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([x, np.cross(z, x), z])
        pose[:3, 3] = -pose[:3, :3] @ centre
        out.append(Camera(size, size, 30.0, 30.0, size / 2, size / 2, pose, name=name))
    return out


def pictures(folder, cameras):
    for k, camera in enumerate(cameras):
        write_png(folder / f"{k:03d}.png", np.full((camera.height, camera.width, 3), 40 + k, np.uint8))


def with_transforms(root, cameras, change=lambda table: None):
    pictures(root / "images", cameras)
    table = {"frames": [{"file_path": f"images/{k:03d}.png", **frame_of(c)} for k, c in enumerate(cameras)]}
    change(table)
    (root / "transforms.json").write_text(json.dumps(table))


def quaternion_of(camera):
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(camera.world_to_camera[:3, :3]).as_quat()
    return np.array([w, x, y, z])


def binary_model(folder, cameras, lens=None, quaternion=quaternion_of, model=1, size=(16, 16)):
    lens = [30.0, 30.0, 8.0, 8.0] if lens is None else lens
    folder.mkdir(parents=True)
    out = struct.pack("<Q", len(cameras))
    for k, c in enumerate(cameras):
        out += struct.pack("<I7dI", k + 1, *quaternion(c), *c.world_to_camera[:3, 3], 1) + b"%03d.png\0" % k + bytes(8)
    (folder / "images.bin").write_bytes(out)
    (folder / "cameras.bin").write_bytes(struct.pack("<QIiQQ", 1, 1, model, *size) + struct.pack(f"<{len(lens)}d", *lens))


def text_model(folder, cameras, lens="PINHOLE 16 16 30 30 8 8", between="\n", quaternion=quaternion_of):
    folder.mkdir(parents=True)
    rows = [
        f"{k + 1} {' '.join(map(str, quaternion(c)))} {' '.join(map(str, c.world_to_camera[:3, 3]))} 1 {k:03d}.png\n"
        for k, c in enumerate(cameras)
    ]
    (folder / "images.txt").write_text("# images\n" + between.join(rows) + between)
    (folder / "cameras.txt").write_text(f"1 {lens}\n")


def refused(root, *words):
    with pytest.raises(UserError) as caught:
        open_capture(root)
    line = str(caught.value)
    assert "\n" not in line
    for word in words:
        assert word in line, line


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.update(fl_x=0), ("above 0",)),
        (lambda f: f.update(fl_x=float("inf")), ("fl_x", "finite")),
        (lambda f: f.update(cx=float("nan")), ("cx", "finite")),
        (lambda f: f.update(cx=1e9), ("principal point",)),
        (lambda f: f.update(fl_x=0.9, fl_y=0.9, w=1600, h=1600), ("pixels",)),
        (lambda f: f.update(w=0), ("above 0",)),
        (lambda f: f.update(w=16.5), ("w = 16.5",)),
        (lambda f: f.update(h="96 px"), ("h = '96 px'",)),
        (lambda f: f.update(fl_x=[3]), ("fl_x",)),
        (lambda f: f.update(fl_x=True), ("fl_x",)),
        (lambda f: f.update(transform_matrix=[[1, 0, 0], [0, 1, 0, 0]]), ("transform_matrix",)),
        (lambda f: f.update(transform_matrix="none"), ("transform_matrix",)),
        (lambda f: f.update(transform_matrix=(1.05 * np.eye(4)).tolist()), ("no rotation",)),
        (lambda f: f.update(transform_matrix=np.diag([1, 1, -1, 1]).tolist()), ("no rotation",)),
        (lambda f: f.update(transform_matrix=[[0, 0, 0, 1]] * 3), ("no rotation",)),
        (lambda f: f["transform_matrix"][3].__setitem__(0, 0.5), ("matrix",)),
        (lambda f: f["transform_matrix"][0].__setitem__(3, 1e308), ("no place",)),
        (lambda f: f.update(mask_path=5), ("mask_path = 5", "not text")),
        (lambda f: f.update(file_path="a" * 5000), ("no file name",)),
    ],
)
def test_a_frame_of_transforms_json_that_can_be_no_camera(tmp_path, change, words):
    with_transforms(tmp_path, ring(3), lambda table: change(table["frames"][1]))
    refused(tmp_path, "transforms.json", *words)


def test_a_transforms_json_that_is_no_json_file(tmp_path):
    with_transforms(tmp_path, ring(3))
    path = tmp_path / "transforms.json"
    path.write_text("[" * 200_000)
    refused(tmp_path, "transforms.json", "JSON")
    path.unlink()
    os.mkfifo(path)
    refused(tmp_path, "transforms.json", "not a regular file")


@pytest.mark.parametrize("write", [binary_model, text_model])
def test_a_colmap_model_that_can_be_no_camera_names_its_own_file(tmp_path, write):
    cameras = ring(4)
    suffix = "bin" if write is binary_model else "txt"
    text = write is text_model
    faults = {
        "zero": ({"quaternion": lambda c: np.zeros(4)}, f"images.{suffix}"),
        "nan": ({"quaternion": lambda c: np.full(4, np.nan)}, f"images.{suffix}"),
        "negative": ({"lens": "PINHOLE 16 16 -30 30 8 8" if text else [-30.0, 30.0, 8.0, 8.0]}, f"cameras.{suffix}"),
        "focal nan": ({"lens": "PINHOLE 16 16 nan 30 8 8" if text else [np.nan, 30.0, 8.0, 8.0]}, f"cameras.{suffix}"),
        "width": ({"lens": "PINHOLE 0 16 30 30 8 8"} if text else {"size": (0, 16)}, f"cameras.{suffix}"),
    }
    for name, (more, file) in faults.items():
        root = tmp_path / name
        pictures(root / "images", cameras)
        write(root / "sparse" / "0", cameras, **more)
        refused(root, file)


def test_images_txt_without_its_lines_of_points_keeps_every_camera(tmp_path):
    cameras = ring(6)
    pictures(tmp_path / "a/images", cameras)
    text_model(tmp_path / "a/sparse/0", cameras, between="")
    pictures(tmp_path / "b/images", cameras)
    text_model(tmp_path / "b/sparse/0", cameras, between="1.5 2.5 -1 3 4 17\n")
    for name in "ab":
        capture = open_capture(tmp_path / name)
        assert len(capture.cameras) == 6 and not capture.warnings
        np.testing.assert_allclose(capture.cameras["003"].world_to_camera, cameras[3].world_to_camera, atol=1e-9)


def test_points3d_bin_that_declares_more_than_it_holds_takes_no_memory(tmp_path):
    cameras = ring(3)
    pictures(tmp_path / "images", cameras)
    binary_model(tmp_path / "sparse/0", cameras)
    (tmp_path / "sparse/0/points3D.bin").write_bytes(struct.pack("<Q", 1 << 40) + b"\0" * 200)
    refused(tmp_path, "points3D.bin", "ends early")


def test_every_camera_at_one_place_is_refused_where_a_model_would_be_made(tmp_path):
    with_transforms(tmp_path / "a", [ring(9)[0]] * 9)
    refused(tmp_path / "a", "transforms.json", "one place")
    with_transforms(tmp_path / "b", [ring(3)[0]] * 3)
    assert len(open_capture(tmp_path / "b").views) == 3


def test_archives_of_cameras_are_checked_and_only_their_cameras_are_read(tmp_path, scene, write):
    def matrices(name, **more):
        root = tmp_path / name
        write.pandora(root, scene)
        table = dict(np.load(root / "cameras.npz"))
        np.savez(root / "cameras.npz", **{**table, **more})
        return root

    good = matrices("good", spare=np.zeros((1 << 20, 3)), text=np.array(["a", "b"]))
    assert len(open_capture(good).cameras) == 3
    refused(matrices("singular", world_mat_1=np.zeros((4, 4))), "cameras.npz", "world_mat_1", "singular")
    refused(matrices("nan", world_mat_1=np.full((4, 4), np.nan)), "cameras.npz", "world_mat_1", "finite")
    refused(matrices("text", world_mat_1=np.array(["x"])), "cameras.npz", "world_mat_1", "not numbers")
    bad = matrices("npy")
    np.save(bad / "x.npy", np.zeros(3))
    (bad / "x.npy").rename(bad / "cameras.npz")
    refused(bad, "cameras.npz", "cannot be read")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"intrinsics": np.diag([0.0, 40, 1])}, ("above 0",)),
        ({"intrinsics": np.diag([np.nan, 40, 1])}, ("finite",)),
        ({"intrinsics": np.eye(4)}, ("shape",)),
        ({"extrinsics": np.tile(2 * np.eye(4), (3, 1, 1))}, ("no rotation",)),
        ({"image_width": np.array([np.nan])}, ("image_width",)),
        ({"image_width": np.array([32, 32])}, ("image_width",)),
    ],
)
def test_phygaps_parameters_that_can_be_no_camera(tmp_path, scene, write, change, words):
    write.phygap_mitsuba(tmp_path, scene)
    table = dict(np.load(tmp_path / "camera_params.npz"))
    np.savez(tmp_path / "camera_params.npz", **{**table, **change})
    refused(tmp_path, "camera_params.npz", *words)


def huge_npy(path, shape):
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
        file.write(b"\0" * 64)


def test_arrays_are_refused_by_their_headers(tmp_path, scene, write):
    write.smvp3d(tmp_path, scene)
    for shape in ((200_000, 200_000, 3), (24, 32, 3), (-3, 4, 3), (24, 32, 5)):
        huge_npy(tmp_path / "s0" / "0000.npy", shape)
        with pytest.raises(UserError, match=r"0000\.npy"):
            open_capture(tmp_path).view("0000").read()
    np.save(tmp_path / "s0" / "0000.npy", np.array([["a"]]))
    refused(tmp_path, "0000.npy", "not numbers")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("focal_px = 0", ("focal_px",)),
        ("focal_px = nan", ("focal_px",)),
        ("marker_length = -1", ("marker_length",)),
        ('marker_dictionary = "zz"', ("marker_dictionary", "4X4_50")),
        ('scale_pair = ["000", "001"]\nscale_distance = 0', ("scale_distance",)),
        ('scale_pair = ["000", "001"]\nscale_distance = nan', ("scale_distance",)),
        ('scale_pair = ["000", "001"]', ("scale_pair", "scale_distance")),
        ('scale_pair = ["000", "000"]\nscale_distance = 1', ("scale_pair",)),
        ('scale_pair = ["000", "01"]\nscale_distance = 1', ("'01'", "no view", "001")),
    ],
)
def test_what_capture_toml_tells_of_cameras_is_checked_though_they_are_given(tmp_path, text, words):
    with_transforms(tmp_path, ring(3))
    (tmp_path / "capture.toml").write_text(f"[poses]\n{text}\n")
    refused(tmp_path, "capture.toml", *words)


def test_the_markers_known_by_name_are_opencvs():
    import cv2

    from pipeline.capture.config import MARKERS

    theirs = {n.removeprefix("DICT_").upper() for n in dir(cv2.aruco) if n.startswith("DICT_")}
    assert set(MARKERS) <= theirs


def moved(camera, turn, scale, shift, name="b"):
    """The camera in a world turned, scaled and moved."""
    pose = np.eye(4)
    pose[:3, :3] = camera.world_to_camera[:3, :3] @ turn.T
    pose[:3, 3] = -pose[:3, :3] @ (scale * turn @ camera.centre + shift)
    return Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, pose, name=name)


def test_two_cameras_of_two_worlds_are_told_from_a_head_in_one():
    from scipy.spatial.transform import Rotation

    turn, none = Rotation.from_euler("xyz", [40, 70, -20], degrees=True).as_matrix(), np.eye(3)
    path = ring(10)
    first = {f"{k:03d}": c for k, c in enumerate(path)}
    head = {f"{k:03d}": moved(c, none, 1.0, np.array([0.1, 0.05, 0])) for k, c in enumerate(path)}
    assert two_worlds(first, head) is None and two_worlds(first, first) is None
    elsewhere = {n: moved(c, turn, 0.4, np.array([1, 2, -0.5])) for n, c in first.items()}
    assert two_worlds(first, elsewhere)
    beside = {n: moved(c, Rotation.from_euler("y", 25, degrees=True).as_matrix(), 1.0, np.zeros(3)) for n, c in first.items()}
    assert two_worlds(first, beside) is None, "two cameras beside a turntable"
    other_names = {f"x{n}": moved(c, turn, 1.0, np.array([0, 30.0, 0])) for n, c in first.items()}
    assert "places" in two_worlds(first, other_names)


def test_two_folders_with_models_of_their_own_worlds_are_refused(tmp_path):
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("xyz", [70, 20, 0], degrees=True).as_matrix()
    path = ring(8)
    for name, cameras in (("left", path), ("right", [moved(c, turn, 0.5, np.ones(3)) for c in path])):
        pictures(tmp_path / name / "images", cameras)
        binary_model(tmp_path / name / "sparse/0", cameras)
    refused(tmp_path, "left and right", "COLMAP model")


def test_a_rig_camera_file_that_can_be_no_camera(tmp_path):
    from pipeline.capture.layouts.ict_light_stage import read_camera

    text = "#focal\n{f} {f}\n#principal\n8 8\n#resolution\n16 16\nMATRIX :\n{s} 0 0 0\n0 {s} 0 0\n0 0 {s} 4\n0 0 0 1\n"
    for f, s, word in ((0, 1, "above 0"), (30, 1.2, "no rotation"), (30, 0, "no rotation"), (0.01, 1, "pixels")):
        (tmp_path / "camera00.txt").write_text(text.format(f=f, s=s))
        with pytest.raises(UserError, match=f"camera00.txt.*{word}"):
            read_camera(tmp_path / "camera00.txt", 16, 16)
