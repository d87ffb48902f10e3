"""Lens distortion ends in the poses stage: what later stages read is what a pinhole camera of the same matrix saw."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.images import read_mask, read_stokes, write_mask, write_stokes
from pipeline.geometry.cameras import Camera, frame_of, load_cameras, opengl_from_camera
from pipeline.geometry.lens import Straightener, frames_folder
from stages.calib.poses.straighten import analyser_turn_deg

LENS = (-0.18, 0.04, 0.004, -0.003)
PINHOLE = Camera(160, 120, 130.0, 128.0, 82.0, 58.5, np.eye(4))
BENT = replace(PINHOLE, distortion=LENS)


def seen_by(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(Stokes, mask) of a smooth scene at infinity: a function of the ray alone."""
    x, y, _ = np.moveaxis(camera.rays(), -1, 0)
    s0 = 0.5 + 0.2 * np.sin(14 * x)[..., None] * [1, 0.8, 0.6] + 0.1 * np.cos(11 * y)[..., None]
    stokes = np.stack([s0, 0.3 * s0 * np.sin(9 * y)[..., None], 0.3 * s0 * np.cos(7 * x)[..., None]], 2)
    return stokes.astype(np.float32), (x / 0.3) ** 2 + (y / 0.25) ** 2 < 1


@pytest.mark.parametrize("camera", [PINHOLE, BENT])
def test_rays_through_chosen_pixels_are_those_of_the_image(camera):
    chosen = np.array([0, 159, 160, 7777, 120 * 160 - 1])
    assert np.allclose(camera.rays_through(chosen), camera.rays().reshape(-1, 3)[chosen], rtol=0, atol=1e-12)


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
    from stages.train.views.source_views import load_sources

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


ORIGIN_LIGHT = np.array([0.3, -0.8, 0.5])  # light is polarised along this direction, across each ray


def scene_of(camera: Camera) -> np.ndarray:
    """Stokes image of a scene at infinity in the camera's own frame: what is seen depends on the world direction alone."""
    rays = camera.rays()
    right, up = camera.stokes_frame()
    axis = np.arctan2(up @ ORIGIN_LIGHT, right @ ORIGIN_LIGHT)
    s0 = 0.5 + 0.2 * np.sin(5 * rays @ [1, 0.3, 0.2])[..., None] * [1, 0.8, 0.6]
    twice = np.stack([np.cos(2 * axis), np.sin(2 * axis)], -1)
    return np.nan_to_num(np.concatenate([s0[:, :, None], 0.4 * s0[:, :, None] * twice[..., None]], 2)).astype(np.float32)


def wide_capture(root, cameras, towards, degrees):
    """Views through wide lenses; the mask is what lies within `degrees` of the world direction `towards`."""
    frames = []
    for i, camera in enumerate(cameras):
        write_stokes(root / "images" / f"{i}.exr", scene_of(camera))
        write_mask(root / "masks" / f"{i}.png", np.nan_to_num(camera.rays() @ towards) > np.cos(np.radians(degrees)))
        frames.append({"file_path": f"images/{i}.exr", "mask_path": f"masks/{i}.png", **frame_of(camera)})
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))


def looking(yaw_deg: float, **lens) -> Camera:
    a = np.radians(yaw_deg)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]]
    tilt = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1.0]])
    pose[:3, :3] = tilt @ pose[:3, :3]
    pose[:3, 3] = [0.1 * yaw_deg, 0, 1]
    return Camera(world_to_camera=pose, **lens)


FISHEYE = {"width": 200, "height": 160, "fx": 75.0, "fy": 74.0, "cx": 101.0, "cy": 79.0,
           "distortion": (0.02, -0.004, 0.001, -0.0002), "lens": "OPENCV_FISHEYE"}  # fmt: skip
SPHERE = {"width": 320, "height": 160, "fx": 160 / np.pi, "fy": 160 / np.pi, "cx": 160.0, "cy": 80.0,
          "lens": "EQUIRECTANGULAR"}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lens", "yaws", "degrees"),
    [(FISHEYE, (0, 10, -12), 30), (FISHEYE, (50, -55), 14), (SPHERE, (0, 100, 181), 25)],
    ids=["ahead", "at the edge", "sphere"],
)
def test_wide_lenses_become_pinholes_that_hold_the_object_with_its_polarisation(run_stages, tmp_path, lens, yaws, degrees):
    cameras = [looking(yaw, **lens) for yaw in yaws]
    towards = np.array([0, 0, 1.0])
    wide_capture(tmp_path / "c", cameras, towards, degrees)
    runs = run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses", "masks", masks={"hull_check": False})
    assert not [w for r in runs.values() for w in r.warnings if "outline" not in w and "zero" not in w and "s2" not in w]
    for view, camera in load_cameras(runs["poses"].output / "cameras.json").items():
        assert camera.is_pinhole and max(camera.width, camera.height) <= 2 * 320
        np.testing.assert_allclose(camera.centre, cameras[int(view)].centre, atol=1e-9)
        mask = read_mask(runs["masks"].output / f"{view}.png")
        true = camera.rays() @ towards > np.cos(np.radians(degrees))
        assert (mask != true).mean() < 0.02 and true.any()
        edge = np.concatenate([true[0], true[-1], true[:, 0], true[:, -1]])
        assert not edge.any(), "the picture cuts the object"
        found = read_stokes(runs["poses"].output / f"frames/{view}.exr")
        np.testing.assert_allclose(found[true], scene_of(camera)[true], atol=0.02)


def test_a_wide_turn_is_a_turn_of_the_stokes_axes():
    source = looking(0, **SPHERE)
    target = replace(looking(60, **SPHERE), lens="OPENCV", world_to_camera=looking(60, **SPHERE).world_to_camera)
    lens = Straightener(source, replace(target, width=40, height=30, fx=40.0, fy=40.0, cx=20.0, cy=15.0))
    assert lens.angle is not None and np.degrees(np.abs(lens.angle).max()) > 5
    assert Straightener(source, source).angle is None


def test_a_sphere_without_masks_and_a_lens_that_folds_are_refused(run_stages, tmp_path):
    cameras = [looking(yaw, **SPHERE) for yaw in (0, 20)]
    wide_capture(tmp_path / "c", cameras, np.array([0, 0, 1.0]), 20)
    table = json.loads((tmp_path / "c/transforms.json").read_text())
    for f in table["frames"]:
        del f["mask_path"]
    (tmp_path / "c/transforms.json").write_text(json.dumps(table))
    shutil.rmtree(tmp_path / "c/masks")
    with pytest.raises(UserError, match=r"transforms.json.*equirectangular.*masks/"):
        run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses")
    capture(tmp_path / "f", [replace(PINHOLE, distortion=(-1.5, 0.0, 0.0, 0.0))] * 2)
    with pytest.raises(UserError, match=r"transforms.json.*folds within the image"):
        run_stages(tmp_path / "f", tmp_path / "e", "decode", "poses")


def test_polarisers_behind_a_fisheye_are_warned_of_with_the_size_of_the_turn():
    for degrees, most in ((18, 1.4), (39, 7.2), (60, 19.5)):
        azimuth = np.linspace(0, 2 * np.pi, 361)
        t = np.radians(degrees)
        rays = np.stack([np.sin(t) * np.cos(azimuth), np.sin(t) * np.sin(azimuth), np.full_like(azimuth, np.cos(t))], -1)
        assert analyser_turn_deg(rays) == pytest.approx(most, abs=0.1)
    assert analyser_turn_deg(np.array([[0, 0, 1.0]])) == 0
