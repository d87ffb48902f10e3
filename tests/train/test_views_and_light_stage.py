"""One folder with views and, in olat/, a light stage of the same object: recognised, fitted, and used in training."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.formats.images import STOKES, write_exr, write_png
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, Camera
from pipeline.rig.lobe_names import BECKMANN
from pipeline.rig.map_rendering import render_pixels
from synth.olat_pixels import rig_of

from .conftest import ALBEDO, ROUGHNESS, ellipsoid_hit, ellipsoid_view, look_at, sky

ROOT = Path(__file__).parents[2]

SIZE, VIEWS, LIGHTS, SPECULAR = 32, 10, 40, 0.3
OF_VIEWS = (1, 4)  # whose cameras the light stage has
ALONE = "train.hull_resolution=40 train.max_splats=1200 train.environment_resolution=16 train.indirect=none train.iterations="


def polarfield(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command of this checkout."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    called = [sys.executable, "-m", "stages", *map(str, arguments)]
    return subprocess.run(called, capture_output=True, text=True, timeout=600, env=environment, cwd=ROOT)


def camera_of(k: int) -> Camera:
    angle, height = 2.4 * k, -0.4 + 1.3 * k / VIEWS
    pose = look_at(np.array([np.cos(angle), height, np.sin(angle)]), 4.5)
    return Camera(SIZE, SIZE, 1.7 * SIZE, 1.7 * SIZE, SIZE / 2, SIZE / 2, pose)


def write_views(root: Path) -> None:
    """images/camNN.exr with Stokes vectors, masks/, transforms.json."""
    from pipeline.shading import Prefilter

    light, frames = Prefilter(16, "beckmann").apply(sky()), []
    for k in range(VIEWS):
        camera, name = camera_of(k), f"cam{k:02d}"
        stokes, mask, _ = ellipsoid_view(camera, light)
        write_exr(root / "images" / f"{name}.exr", dict(zip(STOKES, np.moveaxis(stokes.reshape(SIZE, SIZE, 9), -1, 0))))
        write_png(root / "masks" / f"{name}.png", mask.astype(np.float32))
        pose = np.linalg.inv(camera.world_to_camera) @ OPENGL_FROM_OPENCV
        frames.append({"file_path": f"images/{name}.exr", "mask_path": f"masks/{name}.png", "transform_matrix": pose.tolist()})
    lens = {"fl_x": 1.7 * SIZE, "fl_y": 1.7 * SIZE, "cx": SIZE / 2, "cy": SIZE / 2, "w": SIZE, "h": SIZE}
    (root / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))


def write_stage(root: Path) -> None:
    """camNN/cross and camNN/parallel of the same ellipsoid under one light each, mask.png, lights.csv; no camera files."""
    lights = rig_of(LIGHTS).directions
    rows = "\n".join(f"{k},{x:.6f},{y:.6f},{z:.6f}" for k, (x, y, z) in enumerate(lights))
    root.mkdir(parents=True)
    (root / "lights.csv").write_text(f"index,x,y,z\n{rows}\n")
    for k in OF_VIEWS:
        camera, home = camera_of(k), root / f"cam{k:02d}"
        hit, normal = ellipsoid_hit(camera)
        normal, view = normal[hit], -camera.rays().reshape(-1, 3)[hit]
        widths, none = np.full((len(normal), 2), ROUGHNESS**2), np.zeros_like(normal)
        for index, light in enumerate(lights):
            shade, mirrored = np.moveaxis(
                render_pixels(BECKMANN, view, normal, normal, none, widths, np.full(len(normal), SPECULAR), light[None],
                              np.full((1, 3), np.pi), 0.0), 1, 0)  # fmt: skip
            diffuse = shade * ALBEDO / np.pi
            for which, value in (("cross", diffuse / 2), ("parallel", (diffuse + mirrored) / 2)):
                image = np.zeros((SIZE * SIZE, 3), np.float32)
                image[hit] = value
                channels = dict(zip("RGB", np.moveaxis(image.reshape(SIZE, SIZE, 3), -1, 0)))
                write_exr(home / which / f"{index:03d}.exr", channels, half=True)
        write_png(home / "mask.png", hit.reshape(SIZE, SIZE).astype(np.float32))


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Path:
    """A capture of views and a light stage."""
    root = tmp_path_factory.mktemp("both") / "thing"
    write_views(root)
    write_stage(root / "olat")
    return root


@pytest.mark.slow
def test_both_are_recognised_and_the_light_stage_has_the_cameras_of_the_views(both):
    capture = open_capture(both)
    assert (capture.kind, capture.polarisation, len(capture.views)) == ("multiview", "stokes", VIEWS)
    stage = capture.olat
    assert stage is not None and sorted(stage.light_stage.cameras) == [f"cam{k:02d}" for k in OF_VIEWS]
    for k in OF_VIEWS:
        camera = stage.light_stage.cameras[f"cam{k:02d}"].camera
        assert np.allclose(camera.world_to_camera, capture.cameras[f"cam{k:02d}"].world_to_camera)
    assert not capture.warnings


@pytest.mark.slow
def test_the_maps_are_fitted_and_training_takes_them(both, tmp_path):
    dataset = tmp_path / "ds"
    outcome = polarfield("train", both, "--dataset", dataset, "--params", f"{ALONE}30")
    assert outcome.returncode == 0, outcome.stderr
    facts = json.loads((dataset / "train" / "current" / "manifest.json").read_text())["facts"]
    assert set(facts["olat_pixels"]) == {f"cam{k:02d}" for k in OF_VIEWS} and min(facts["olat_pixels"].values()) > 100
    plan = json.loads((dataset / "dataset.json").read_text())["plan"]
    assert plan["olat"]["run"] and plan["train"]["passes"]["olat_priors"]["run"]
    masks = dataset / "masks" / "current"
    assert (masks / "cam01.png").is_file() and (masks / "olat" / "cam01.png").is_file()
    log = (dataset / "train" / "current" / "train_log.csv").read_text()
    assert "olat_normal" in log
    (both / "olat" / "lights.csv").write_text((both / "olat" / "lights.csv").read_text() + "\n")
    again = polarfield("plan", both, "--dataset", dataset, "--params", f"{ALONE}30")
    assert again.returncode == 0, again.stderr
    row = next(line for line in again.stdout.splitlines() if line.split()[1:2] == ["train"])
    assert "done" not in row, row
