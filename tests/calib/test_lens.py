"""Lens distortion ends in the poses stage: what later stages read is what a pinhole camera of the same matrix saw."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.formats.images import read_mask, read_stokes, write_mask, write_stokes
from pipeline.geometry.cameras import Camera, distort, load_cameras, opengl_from_camera, undistort
from pipeline.geometry.lens import frames_folder

LENS = (-0.18, 0.04, 0.004, -0.003)
PINHOLE = Camera(160, 120, 130.0, 128.0, 82.0, 58.5, np.eye(4))
BENT = replace(PINHOLE, distortion=LENS)


def seen_by(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(Stokes, mask) of a smooth scene at infinity: a function of the ray alone."""
    x, y, _ = np.moveaxis(camera.rays(), -1, 0)
    s0 = 0.5 + 0.2 * np.sin(14 * x)[..., None] * [1, 0.8, 0.6] + 0.1 * np.cos(11 * y)[..., None]
    stokes = np.stack([s0, 0.3 * s0 * np.sin(9 * y)[..., None], 0.3 * s0 * np.cos(7 * x)[..., None]], 2)
    return stokes.astype(np.float32), (x / 0.3) ** 2 + (y / 0.25) ** 2 < 1


def capture(root, cameras, masks=True):
    frames = []
    for i, camera in enumerate(cameras):
        stokes, mask = seen_by(camera)
        write_stokes(root / "images" / f"{i}.exr", stokes)
        write_mask(root / "masks" / f"{i}.png", mask)
        keys = dict(zip(("k1", "k2", "p1", "p2"), camera.distortion))
        frames.append({"file_path": f"images/{i}.exr", "transform_matrix": opengl_from_camera(camera.world_to_camera).tolist(),
                       "w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx,
                       "cy": camera.cy, "mask_path": f"masks/{i}.png", **keys})  # fmt: skip
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))


def test_bending_and_straightening_are_inverse():
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (200, 2))
    np.testing.assert_allclose(undistort(distort(points, LENS), LENS), points, atol=1e-9)


def test_frames_masks_and_cameras_after_poses_are_a_pinhole_cameras(run_stages, tmp_path):
    capture(tmp_path / "c", [BENT, PINHOLE, BENT, PINHOLE])
    runs = run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses", "masks")
    inputs = {"decode": runs["decode"].output, "poses": runs["poses"].output}
    assert frames_folder(inputs) == inputs["poses"]
    stokes, mask = seen_by(PINHOLE)
    table = json.loads((inputs["poses"] / "frames.json").read_text())["views"]
    for view, camera in load_cameras(inputs["poses"] / "cameras.json").items():
        assert not camera.distortion and (camera.fx, camera.fy, camera.cx, camera.cy) == (130.0, 128.0, 82.0, 58.5)
        saturated = table[view]["saturated"]
        known = ~read_mask(inputs["poses"] / saturated) if saturated else np.ones_like(mask)
        assert known.mean() > 0.9
        found = read_stokes(inputs["poses"] / table[view]["file"])
        assert np.abs(found - stokes)[known].max() < 0.01  # 1 % of the light: bilinear, and half floats
        assert (read_mask(runs["masks"].output / f"{view}.png") != mask).mean() < 0.01
    before = read_stokes(inputs["decode"] / "frames/0.exr")
    np.testing.assert_allclose(before, seen_by(BENT)[0], rtol=1e-3, atol=1e-6)  # decode leaves frames as they were taken


def test_straight_lenses_leave_no_second_frames(run_stages, tmp_path):
    almost = replace(PINHOLE, distortion=(1e-6, 0.0, 0.0, 0.0))
    capture(tmp_path / "c", [PINHOLE, almost])
    runs = run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses")
    assert not (runs["poses"].output / "frames").exists()
    assert frames_folder({n: r.output for n, r in runs.items()}) == runs["decode"].output


@pytest.mark.slow
def test_training_sources_of_a_bent_lens_are_those_of_a_straight_one(run_stages, tmp_path):
    from stages.train.views.data import load_sources

    sources = []
    for name, camera in (("bent", BENT), ("straight", PINHOLE)):
        capture(tmp_path / name, [camera] * 6)
        runs = run_stages(tmp_path / name, tmp_path / f"{name}.d", "decode", "poses", "masks")
        inputs = {n: r.output for n, r in runs.items()}
        sources.append(load_sources(frames_folder(inputs), inputs["poses"], inputs["masks"], "auto")[0][0])
    bent, straight = sources
    known = bent.valid & (bent.mask > 0.99)
    assert known.sum() > 0.95 * (straight.mask > 0.99).sum()
    assert np.abs(bent.image - straight.image)[known].max() < 0.01
    np.testing.assert_array_equal(bent.camera.intrinsics, straight.camera.intrinsics)
