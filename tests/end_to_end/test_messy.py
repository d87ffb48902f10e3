"""A capture as a person would take it: two cameras behind polarisers whose angles are stated wrong, a busy background in
view, no masks, rolled cameras, noise, clipping, spaces and brackets in names. Shaded here, so no renderer is needed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.formats.images import read_mask, write_exr
from pipeline.geometry.cameras import Camera, opengl_from_camera

from .conftest import polarfield

ANGLES = {"left (1)": 31.0, "right [2]": 119.0}
STATED = {"left (1)": 36.0, "right [2]": 114.0}
SIZE, VIEWS, NOISE, CLIP = 72, 20, 3e-3, 1.6
BLOBS = (((0.0, 0.0, 0.0), (0.62, 0.5, 0.55)), ((0.1, 0.62, 0.05), (0.3, 0.34, 0.3)), ((0.55, -0.05, 0.0), (0.3, 0.18, 0.2)))
"""Ellipsoids: centre and half axes."""


def surroundings(direction: np.ndarray) -> np.ndarray:
    """Radiance [..., 3] from unit directions: ground, sky, a soft sun, and blotches as of leaves."""
    rng = np.random.default_rng(11)
    blotches = np.sum([0.4 * np.sin(direction @ rng.normal(0, 6, 3) + rng.uniform(0, 6)) for _ in range(8)], axis=0)
    level = 0.16 * np.exp(blotches)[..., None] * [0.8, 1.0, 0.6] + 0.5 * np.clip(direction[..., 1:2], 0, 1) * [0.7, 0.9, 1.2]
    sun = np.array([0.5, 0.1, 0.62]) / np.linalg.norm([0.5, 0.1, 0.62])
    return level + 14.0 * np.exp(40 * (direction @ sun - 1))[..., None]


def cameras() -> list[Camera]:
    """Around the object, rolled by up to 30 degrees."""
    out = []
    for k in range(VIEWS):
        azimuth, elevation = 2.4 * k, np.radians(-10 + 60 * ((k * 0.618) % 1))
        position = 4.5 * np.array([np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)])
        z = -position / np.linalg.norm(position)
        x = np.cross(z, [0, 1, 0])
        x /= np.linalg.norm(x)
        roll = np.radians(30) * np.sin(3.7 * k)
        c, s = np.cos(roll), np.sin(roll)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([c * x + s * np.cross(z, x), c * np.cross(z, x) - s * x, z])
        pose[:3, 3] = -pose[:3, :3] @ position
        out.append(Camera(SIZE, SIZE, 1.9 * SIZE, 1.9 * SIZE, SIZE / 2, SIZE / 2, pose))
    return out


def picture(camera: Camera, light: object) -> tuple[np.ndarray, np.ndarray]:
    """(Stokes [H, W, 3, 3], mask [H, W]) of the blobs of polarised plastic before their surroundings."""
    import torch

    from pipeline.shading import shade

    rays = camera.rays().reshape(-1, 3)
    depth, normal = np.full(len(rays), np.inf), np.zeros_like(rays)
    for centre, axes in BLOBS:
        origin = camera.centre - centre
        a, b, c = ((rays / axes) ** 2).sum(-1), (rays * origin / np.square(axes)).sum(-1), ((origin / axes) ** 2).sum() - 1
        root = b * b - a * c
        t = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
        near = t < depth
        depth = np.where(near, t, depth)
        outward = (origin + rays * np.where(np.isfinite(t), t, 0)[:, None]) / np.square(axes)
        normal[near] = (outward / np.linalg.norm(outward, axis=-1, keepdims=True))[near]
    hit = np.isfinite(depth)
    x, y = (f.reshape(-1, 3)[hit] for f in camera.stokes_frame())
    n, p, q, r = (torch.as_tensor(v, dtype=torch.float32) for v in (normal[hit], -rays[hit], x, y))
    count = int(hit.sum())
    albedo = torch.tensor([0.45, 0.33, 0.08]).expand(count, 3)
    shaded = shade(n, p, albedo, torch.full((count,), 0.3), torch.full((count,), 1.5), q, r, light)
    stokes = np.zeros((len(rays), 3, 3))
    stokes[:, 0] = surroundings(rays)  # unpolarised
    stokes[hit] = shaded.stokes.numpy()
    return stokes.reshape(SIZE, SIZE, 3, 3), hit.reshape(SIZE, SIZE)


@pytest.fixture(scope="module")
def messy(tmp_path_factory) -> tuple[Path, dict[str, np.ndarray]]:
    """The capture folder and the true masks by VIEW."""
    import torch

    from pipeline.shading import Prefilter, cube_directions

    root = tmp_path_factory.mktemp("messy") / "as taken, Sunday (ä)"
    light = Prefilter(32, "beckmann").apply(torch.as_tensor(surroundings(cube_directions(32)), dtype=torch.float32))
    rng = np.random.default_rng(0)
    frames, masks = [], {}
    for k, camera in enumerate(cameras()):
        name = list(ANGLES)[k % 2]
        stokes, mask = picture(camera, light)
        t = 2 * np.radians(ANGLES[name])
        seen = (stokes[:, :, 0] + stokes[:, :, 1] * np.cos(t) + stokes[:, :, 2] * np.sin(t)) / 2
        seen = np.minimum(seen + rng.normal(0, NOISE, seen.shape), CLIP).astype(np.float32)
        file = f"images/{name}/IMG_{1200 + 7 * k} ({k % 3}).exr"
        write_exr(root / file, {c: seen[..., i] for i, c in enumerate("RGB")}, half=True)
        matrix = opengl_from_camera(camera.world_to_camera).tolist()
        frames.append({"file_path": file, "camera": name, "transform_matrix": matrix})
        masks[f"{name}_IMG_{1200 + 7 * k} ({k % 3})"] = mask
    table = {"fl_x": 1.9 * SIZE, "fl_y": 1.9 * SIZE, "w": SIZE, "h": SIZE, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(table))
    toml = "\n".join(f'[polarisers."{name}"]\nangle_deg = {angle}\ntrusted = false' for name, angle in STATED.items())
    (root / "capture.toml").write_text(toml + "\n")
    return root, masks


@pytest.mark.slow
def test_messy_capture_finds_the_object_and_the_polarisers(messy, tmp_path):
    root, truth = messy
    outcome = polarfield("train", root, "--dataset", tmp_path / "d", "--params", "train.iterations=300")
    assert outcome.status == 0, outcome.err
    frames = json.loads((tmp_path / "d/decode/current/frames.json").read_text())["views"]
    assert set(frames) == set(truth) and any(f["saturated"] for f in frames.values())
    scores = []
    for view, mask in truth.items():
        found = read_mask(tmp_path / "d/masks/current" / f"{view}.png")
        scores.append((found & mask).sum() / (found | mask).sum())
    assert np.mean(scores) > 0.95, scores  # measured 0.984
    found = json.loads((tmp_path / "d/train/current/polarisers.json").read_text())
    errors = {name: abs((found[name]["angle_deg"] - angle + 90) % 180 - 90) for name, angle in ANGLES.items()}
    assert max(errors.values()) < 3, errors  # measured 1.6 and 1.8
