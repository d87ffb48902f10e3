"""What `export` writes is whole, opens, and overwrites nothing."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from pipeline.asset.asset import FORMATS as ASSET_FORMATS
from pipeline.engine.dataset import Dataset
from pipeline.errors import UserError
from pipeline.formats.colmap import read_model
from pipeline.formats.images import image_size, read_image, srgb_decode, write_exr, write_mask
from pipeline.geometry.cameras import Camera, camera_from_opengl, load_cameras, save_cameras
from stages import FORMATS
from stages.exporting import export
from synth.orbit import fibonacci_sphere, look_at

VIEWS = ("a", "b c")


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
    (root / "train/gaussians.ply").write_bytes(b"ply")
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


def test_pictures_share_one_exposure(dataset):
    out = export(dataset, "nerfstudio", "")
    dark, bright = (srgb_decode(read_image(out / "images" / f"{v}.png")) for v in VIEWS)
    assert np.allclose(2 * dark[1:3], bright[1:3], atol=0.02)
    assert bright.max() == 1


def test_colmap_reads_the_model_and_its_pictures_are_there(dataset):
    out = export(dataset, "colmap", "")
    names = set(read_model(out / "sparse" / "0").cameras)
    assert len(names) == len(VIEWS)
    written = [line.split(" ", 9)[9] for line in (out / "sparse/0/images.txt").read_text().splitlines() if line[:1].isdigit()]
    assert written == ["a.png", "b c.png"]
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
    (dataset.root / "train/gaussians.ply").unlink()
    (dataset.root / "train").rmdir()
    with pytest.raises(UserError, match="no results of the train stage"):
        export(dataset, "splat", str(tmp_path / "s"))
