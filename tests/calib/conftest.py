"""Running single stages on little captures."""

from __future__ import annotations

import importlib
import io
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.geometry.cameras import Camera


@pytest.fixture
def run_stages():
    """run_stages(root, out, "decode", "poses", decode={...}) -> {stage: StageRun} of stages run one after the other."""

    def run(root: Path, out: Path, *names: str, **parameters: dict) -> dict[str, StageRun]:
        capture, inputs, runs = open_capture(root), {}, {}
        modules = {"decode": "stages.calib.decode", "poses": "stages.calib.poses", "masks": "stages.masks"}
        for name in names:
            stage = importlib.import_module(f"{modules[name]}.stage").STAGE
            output, scratch = out / name, out / f"{name}.scratch"
            output.mkdir(parents=True)
            scratch.mkdir()
            chosen = stage.parameters(**parameters.get(name, {}))
            runs[name] = StageRun(capture, chosen, dict(inputs), output, scratch, progress=Progress(io.StringIO()), jobs=2)
            assert stage.needed(capture, chosen).run
            stage.run(runs[name])
            inputs[name] = output
        return runs

    return run


MARKER_SIDE = 120 * 2 / 540


def looking_at_the_corner(azimuth_deg: float, rise: float) -> Camera:
    """A camera at a distance of about 4 units."""
    angle = np.radians(azimuth_deg)
    position = 4.2 * np.array([np.cos(angle), 0.55 + rise, np.sin(angle)]) + [0.5, 0.5, 0.5]
    z = np.array([0.5, 0.45, 0.5]) - position
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 1, 0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z])
    pose[:3, 3] = -pose[:3, :3] @ position
    return Camera(480, 360, 560.0, 560.0, 240.0, 180.0, pose)


def corner_picture(camera: Camera) -> np.ndarray:
    """A photograph (8-bit) of a textured corner of three planes; an ArUco marker (4X4_50) of MARKER_SIDE lies in one."""
    import cv2

    rng = np.random.default_rng(5)
    sheets = [
        cv2.resize(rng.integers(30, 255, (90, 90, 3)).astype(np.uint8), (540, 540), interpolation=cv2.INTER_CUBIC)
        for _ in range(3)
    ]
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 7, 120)
    sheets[1][180:340, 180:340] = 255
    sheets[1][200:320, 200:320] = np.maximum(marker, 1)[:, ::-1, None]  # the planes' axes are left-handed as seen
    image = np.zeros((360, 480, 3), np.uint8)
    for sheet, axes in zip(sheets, (np.eye(3)[[0, 1, 2]], np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 0, 1]])):
        # Sheet pixel (u, v) lies at 2 (u, v) / 540 along the plane's two axes.
        plane = np.stack([axes[0] * 2 / 540, axes[1] * 2 / 540, np.zeros(3)], 1)
        pose = camera.world_to_camera
        h = camera.intrinsics @ (pose[:3, :3] @ plane + np.outer(pose[:3, 3], [0, 0, 1]))
        warped = cv2.warpPerspective(sheet, h, (480, 360), flags=cv2.INTER_AREA)
        image = np.where(warped.any(-1, keepdims=True), warped, image)
    return image


@pytest.fixture
def corner_scene() -> SimpleNamespace:
    """camera(azimuth_deg, rise) and picture(camera) of the textured corner."""
    return SimpleNamespace(camera=looking_at_the_corner, picture=corner_picture, marker_side=MARKER_SIDE)


@pytest.fixture
def corner() -> tuple[list[np.ndarray], list[Camera]]:
    """Photographs of the textured corner, and their cameras."""
    cameras = [looking_at_the_corner(25 + 6 * i, 0.05 * (i % 3)) for i in range(7)]
    return [corner_picture(c) for c in cameras], cameras
