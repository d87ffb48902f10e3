"""What `export` writes is whole, opens, and overwrites nothing."""

from __future__ import annotations

import json
import shutil
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from pipeline.asset.asset import FORMATS as ASSET_FORMATS
from pipeline.engine.dataset import Dataset
from pipeline.errors import UserError
from pipeline.formats.colmap import read_model
from pipeline.formats.images import channel_names, image_size, read_image, read_mask, srgb_decode, write_exr, write_mask
from pipeline.formats.ply import Ply, write_ply
from pipeline.geometry.cameras import Camera, camera_from_opengl, frame_of, load_cameras, save_cameras
from pipeline.splats.cloud import SplatCloud
from pipeline.splats.splat_ply import read_splat_ply, write_splat_ply
from stages import FORMATS
from stages.exporting import export
from synth.orbit import fibonacci_sphere, look_at

VIEWS = ("a", "b c")


def write_splats(train) -> None:
    """Three Gaussians, z up, as the train stage leaves them: with material, and lit."""
    rng = np.random.default_rng(0)
    q = np.array([[1.0, 0, 0, 0], [0.6, 0.8, 0, 0], [0.6, 0, 0.8, 0]])
    cloud = SplatCloud(rng.normal(size=(3, 3)), q, rng.uniform(-4, -2, (3, 3)), np.ones(3), rng.normal(0, 0.1, (3, 16, 3)))
    write_splat_ply(train / "splats_lit.ply", cloud)
    columns = {n: np.full(3, 0.5) for n in ("albedo_r", "albedo_g", "albedo_b", "roughness", "ior", "nx", "ny")}
    write_ply(train / "gaussians.ply", {**dict(zip("xyz", cloud.means.T)), **columns, "nz": np.ones(3)})
    (train / "lighting.json").write_text(json.dumps({"up": "z"}))


def write_maps(root) -> None:
    """One light-stage camera, looking along world x, whose whole surface faces it."""
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    entry = {"camera": frame_of(Camera(3, 2, 9.0, 9.0, 1.5, 1.0, pose))}
    (root / "decode/olat.json").write_text(json.dumps({"cameras": {"cam00": entry}}))
    (root / "olat" / "cam00").mkdir(parents=True)
    (root / "olat/maps.json").write_text(json.dumps({"lobe": "ggx"}))
    ones = np.ones((2, 3), np.float32)
    for name in ("normal", "diffuse_normal", "specular_normal", "tangent"):
        write_exr(root / f"olat/cam00/{name}.exr", {"X": -ones, "Y": 0 * ones, "Z": 0 * ones})
    for name in ("specular_albedo", "roughness", "anisotropy", "occlusion_d", "occlusion_s"):
        write_exr(root / f"olat/cam00/{name}.exr", {"Y": 0.25 * ones})
    write_exr(root / "olat/cam00/diffuse_albedo.exr", {c: 0.5 * ones for c in "RGB"})
    write_exr(root / "olat/cam00/sigma.exr", {"X": 0.5 * ones, "Y": 0.25 * ones})
    write_exr(root / "olat/cam00/residual.exr", {"Y": 0 * ones, "flag": 4 * ones})


@pytest.fixture
def dataset(tmp_path) -> Dataset:
    """Two views as the stages leave them, and a mesh's asset of empty files."""
    root = tmp_path / "d"
    for name in ("decode/frames", "poses/sparse", "masks", "mesh/asset/textures", "train"):
        (root / name).mkdir(parents=True)
    pose = [camera_from_opengl(look_at(4 * d)) for d in fibonacci_sphere(len(VIEWS))]
    cameras = {view: Camera(6, 4, 9.0, 9.0, 3.0, 2.0, p) for view, p in zip(VIEWS, pose)}
    save_cameras(root / "poses" / "cameras.json", cameras, {v: f"../decode/frames/{v}.exr" for v in VIEWS})
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"]
    for k, view in enumerate(VIEWS):
        lines += [f"{k + 1} 1 0 0 0 0 0 4 1 {view}.exr", ""]
    (root / "poses/sparse/images.txt").write_text("\n".join(lines) + "\n")
    (root / "poses/sparse/cameras.txt").write_text("1 PINHOLE 6 4 9 9 3 2\n")
    (root / "poses/sparse/points3D.txt").write_text("1 0 0 0 9 9 9 0\n")
    (root / "decode/frames.json").write_text(json.dumps({"views": {v: {} for v in VIEWS}}))
    for k, view in enumerate(VIEWS):
        ramp = (k + 1) * np.linspace(0, 1, 24, dtype=np.float32).reshape(4, 6)
        write_exr(root / "decode/frames" / f"{view}.exr", {f"S{i}.{c}": ramp * (i == 0) for i in range(3) for c in "RGB"})
        write_mask(root / "masks" / f"{view}.png", np.ones((4, 6), bool))
    for name in {n for names in ASSET_FORMATS.values() for n in names} - {"textures"} | {"asset.json", "textures/albedo.png"}:
        (root / "mesh/asset" / name).write_bytes(name.encode())
    (root / "mesh/asset/asset.json").write_text("{}")
    write_splats(root / "train")
    write_maps(root)
    made = SimpleNamespace(
        root=root, current=lambda name: SimpleNamespace(folder=root / name) if (root / name).is_dir() else None
    )
    return cast(Dataset, made)


def test_nerfstudio_finds_every_picture_and_mask_and_the_same_cameras(dataset):
    out = export(dataset, "nerfstudio", "")
    assert out.name == "d-nerfstudio"
    frames = json.loads((out / "transforms.json").read_text())["frames"]
    assert len(frames) == len(VIEWS)
    for frame in frames:
        assert image_size(out / frame["file_path"]) == image_size(out / frame["mask_path"]) == (6, 4)
    ours, theirs = load_cameras(dataset.root / "poses/cameras.json"), load_cameras(out / "transforms.json")
    assert all(np.array_equal(ours[v].world_to_camera, theirs[v].world_to_camera) for v in VIEWS)


def test_nerfstudio_gets_a_mask_of_every_frame_and_the_views_that_training_held_back(dataset):
    (dataset.root / "masks" / f"{VIEWS[1]}.png").unlink()  # nerfstudio wants a mask of every frame, or of none
    out = export(dataset, "nerfstudio", "")
    table = json.loads((out / "transforms.json").read_text())
    assert read_mask(out / table["frames"][1]["mask_path"]).all()
    split = {name: table[f"{name}_filenames"] for name in ("train", "val", "test")}
    assert split == {"train": ["images/b c.png"], "val": ["images/a.png"], "test": ["images/a.png"]}
    assert set().union(*split.values()) == {frame["file_path"] for frame in table["frames"]}


def test_pictures_share_one_exposure(dataset):
    out = export(dataset, "nerfstudio", "")
    dark, bright = (srgb_decode(read_image(out / "images" / f"{v}.png")) for v in VIEWS)
    assert np.allclose(2 * dark[1:3], bright[1:3], atol=0.02)
    assert bright.max() == 1


def test_colmap_reads_the_model_and_its_pictures_are_there(dataset):
    out = export(dataset, "colmap", "")
    import pycolmap

    names = set(read_model(out / "sparse" / "0").cameras)
    assert len(names) == len(VIEWS)
    theirs = pycolmap.Reconstruction(str(out / "sparse" / "0"))
    assert sorted(image.name for image in theirs.images.values()) == ["a.png", "b_c.png"]  # it ends a name at a space
    written = [line.split(" ", 9)[9] for line in (out / "sparse/0/images.txt").read_text().splitlines() if line[:1].isdigit()]
    assert written == ["a.png", "b_c.png"]
    assert all((out / "images" / name).exists() for name in written)


@pytest.mark.parametrize("to", FORMATS)
def test_every_format_is_written(dataset, to, tmp_path):
    out = export(dataset, to, str(tmp_path / "new" / "here"))
    assert any(out.iterdir())
    if to in ASSET_FORMATS:
        assert {p.name for p in out.iterdir()} == {*ASSET_FORMATS[to], "asset.json"}


def test_nothing_is_overwritten_and_nothing_half_written(dataset, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    with pytest.raises(UserError, match="exists already"):
        export(dataset, "glb", str(tmp_path / "full"))
    (dataset.root / "mesh/asset/asset.glb").unlink()
    with pytest.raises(OSError):
        export(dataset, "glb", str(tmp_path / "half"))
    assert not (tmp_path / "half").exists()
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_what_was_not_made_is_named(dataset, tmp_path):
    shutil.rmtree(dataset.root / "train")
    with pytest.raises(UserError, match="no results of the train stage"):
        export(dataset, "splat", str(tmp_path / "s"))


def test_exported_splats_are_upright_and_in_metres(dataset, tmp_path):
    before = read_splat_ply(dataset.root / "train/splats_lit.ply")
    (dataset.root / "mesh/asset/asset.json").write_text(json.dumps({"unit_m": 0.01}))
    out = export(dataset, "splat", str(tmp_path / "s"))
    assert {p.name for p in out.iterdir()} == {"splat.ply", "splats_lit.ply", "splats_lit.spz", "splats_lit.glb"}
    after = read_splat_ply(out / "splats_lit.ply")
    x, y, z = 0.01 * before.means.T  # z up: y of a PLY points down, so up is -y
    assert np.allclose(after.means, np.stack([x, -z, y], -1), atol=1e-6)
    camera = np.array([2.0, -3.0, 1.0])
    assert np.allclose(after.colours(0.01 * camera[[0, 2, 1]] * [1, -1, 1]), before.colours(camera), atol=1e-5)
    assert np.array_equal(Ply(out / "splat.ply").vertices(), Ply(dataset.root / "train/gaussians.ply").vertices())


def test_exported_maps_are_in_the_cameras_frame_with_alpha(dataset, tmp_path):
    out = export(dataset, "maps", str(tmp_path / "m")) / "cam00"
    for bits in ("", "_8"):
        normal = read_image(out / f"normal{bits}.png")
        assert normal.shape == (2, 3, 4) and np.allclose(normal, [0.5, 0.5, 1, 1], atol=0.005)
    assert np.allclose(srgb_decode(read_image(out / "diffuse_albedo.png")[..., :3]), 0.5, atol=1e-3)
    assert np.allclose(read_image(out / "sigma.png")[0, 0], [0.5, 0.25, 0, 1], atol=1e-3)
    assert np.allclose(read_image(out / "flag.png") * 255, 4)
    layers = set(channel_names(out / "maps.exr"))
    assert {"R", "A", "normal.B", "sigma.R", "sigma.G", "roughness.Y", "flag.Y"} <= layers
    assert np.allclose(read_image(out / "maps.exr", ["tangent.B"]), 1)


def test_nerfstudios_parser_finds_all_that_it_asserts(dataset):
    """What its own parser (nerfstudio_dataparser.py) asks of a file, in its order."""
    from PIL import Image

    for path in (export(dataset, "nerfstudio", "") / "transforms.json", dataset.root / "poses/cameras.json"):
        meta = json.loads(path.read_text())
        assert meta["camera_model"] in ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE")
        fixed = {key for key in ("fl_x", "fl_y", "cx", "cy", "h", "w") if key in meta}
        masks = 0
        for frame in meta["frames"]:
            assert {"fl_x", "fl_y", "cx", "cy", "h", "w"} <= fixed | set(frame)
            assert np.array(frame["transform_matrix"]).astype(np.float32).shape == (4, 4)
            assert isinstance(frame.get("k1", 0.0), float)
            picture = path.parent / frame["file_path"]
            assert picture.is_file()
            masks += (path.parent / frame["mask_path"]).is_file() if "mask_path" in frame else 0
            if picture.suffix == ".png":  # Pillow, which nerfstudio reads pictures with, knows no EXR
                with Image.open(picture) as opened:
                    assert opened.size == (frame["w"], frame["h"])
        assert masks in (0, len(meta["frames"]))
