"""OpenIllumination's folders: every camera's pictures below a folder a light, positions in light_pos.npy."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.errors import UserError
from pipeline.formats.images import write_mask
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV
from stages.calib.decode.linear_stage_frames import frames_of
from synth.ball import write
from synth.olat_pixels import rig_of

NAMES, SIZE, COUNT = ("A1", "CE2", "F6"), (12, 16), 20


def pose_of(turn: float) -> np.ndarray:
    """World-to-camera (OpenCV) of a camera two units from the origin, looking at it."""
    back = np.array([np.sin(turn), 0.0, np.cos(turn)])
    right, down = np.array([np.cos(turn), 0.0, -np.sin(turn)]), np.array([0.0, -1.0, 0.0])
    out = np.eye(4)
    out[:3, :3] = np.stack([right, down, -back])
    out[:3, 3] = [0.0, 0.0, 2.0]
    return out


def written(root, lights=range(COUNT), positions=COUNT):
    for light in lights:
        for name in NAMES:
            level = np.full((*SIZE, 3), 10 + light, np.uint8)
            write(root / "Lights" / f"{light:03d}" / "raw_undistorted" / f"{name}.png", level)
            write(root / "Lights" / f"{light:03d}" / "obj_masked_thumbnail" / f"{name}.png", level)
    tables = {}
    for k, name in enumerate(NAMES):
        write_mask(root / "output" / "obj_masks" / f"{name}.png", np.ones(SIZE, bool))
        matrix = np.linalg.inv(pose_of(k)) @ OPENGL_FROM_OPENCV
        part = tables.setdefault("test" if name == "CE2" else "train", {})
        part[name] = {"camera_angle_x": 0.5, "transform_matrix": matrix.tolist()}
    for part, frames in tables.items():
        (root / "output" / f"transforms_{part}.json").write_text(json.dumps({"frames": frames}))
    if positions:
        np.save(root / "light_pos.npy", rig_of(positions).directions.astype(np.float32))
    return root


def test_every_camera_has_its_picture_of_every_light(tmp_path):
    capture = open_capture(written(tmp_path))
    stage = capture.light_stage
    assert capture.layout == "open_illumination" and list(stage.cameras) == ["cam00", "cam01", "cam02"]
    assert any("cam01 is CE2" in fact for fact in capture.facts)
    camera = stage.cameras["cam01"]
    assert [p.parts[-3] for p in camera.cross] == [f"{k:03d}" for k in range(COUNT)] and camera.passes == "none"
    assert camera.mask == tmp_path / "output" / "obj_masks" / "CE2.png"
    assert np.allclose(camera.camera.world_to_camera, pose_of(1.0))
    assert (camera.camera.width, camera.camera.fx) == (16, pytest.approx(8 / np.tan(0.25)))
    assert np.allclose(stage.lights.directions, rig_of(COUNT).directions, atol=1e-6)
    names = frames_of(stage)
    assert len(set(names.values())) == len(names) == 3 * COUNT and names[camera.cross[7]].startswith("cam01/")


def test_of_some_lights_only_their_rows_are_taken(tmp_path):
    stage = open_capture(written(tmp_path, (0, 4, 11))).light_stage
    assert np.allclose(stage.lights.directions, rig_of(COUNT).directions[[0, 4, 11]], atol=1e-6)
    assert stage.lights.index.tolist() == [0, 4, 11]


def test_folders_counted_from_one_are_the_rows_from_the_first(tmp_path):
    stage = open_capture(written(tmp_path, range(1, COUNT + 1))).light_stage
    assert len(stage.lights) == COUNT and stage.lights.index.tolist() == list(range(COUNT))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda root: (root / "light_pos.npy").unlink(), "light_pos.npy: is missing"),
        (lambda root: np.save(root / "light_pos.npy", np.zeros((5, 2))), "no table of positions"),
        (lambda root: np.save(root / "light_pos.npy", rig_of(5).directions), "no row for the light of folder 005"),
        (lambda root: (root / "Lights/003/raw_undistorted/A1.png").unlink(), "no picture of camera A1"),
        (lambda root: [p.unlink() for p in (root / "output").glob("*.json")], "transforms_train.json: is missing"),
        (lambda root: (root / "output/transforms_train.json").write_text('{"frames": []}'), "holds no frames by camera"),
        (lambda root: write_mask(root / "output/obj_masks/A1.png", np.ones((5, 5), bool)), "is (5, 5) pixels"),
    ],
)
def test_what_is_missing_is_said(tmp_path, change, words):
    change(written(tmp_path))
    with pytest.raises(UserError) as found:
        open_capture(tmp_path)
    assert words in str(found.value)


def test_patterns_of_many_lights_are_refused(tmp_path):
    with pytest.raises(UserError, match="light patterns"):
        open_capture(written(tmp_path, range(1, 14), 142))
