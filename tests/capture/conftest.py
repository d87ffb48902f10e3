"""A tiny scene of smooth Stokes images and cameras, and writers of every capture layout for it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.formats.images import write_exr, write_mask, write_rgb, write_stokes
from pipeline.geometry.cameras import Camera, opengl_from_camera

HEIGHT, WIDTH = 24, 32


@dataclass
class Scene:
    names: list[str]
    stokes: dict[str, np.ndarray]
    masks: dict[str, np.ndarray]
    cameras: dict[str, Camera]

    def intensity(self, name: str, angle_deg: float) -> np.ndarray:
        """What a camera behind an ideal polariser at this angle sees, [H, W, 3]."""
        s0, s1, s2 = np.moveaxis(self.stokes[name], 2, 0)
        t = 2 * np.radians(angle_deg)
        return ((s0 + s1 * np.cos(t) + s2 * np.sin(t)) / 2).astype(np.float32)


def smooth(rng: np.random.Generator) -> np.ndarray:
    """A smooth field [H, W, 3] in -1..1."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    fx, fy, phase = rng.uniform(0.05, 0.2, 3), rng.uniform(0.05, 0.2, 3), rng.uniform(0, 6, 3)
    return np.sin(x[..., None] * fx + y[..., None] * fy + phase)


@pytest.fixture
def scene() -> Scene:
    rng = np.random.default_rng(7)
    names = [f"{i:04d}" for i in range(3)]
    stokes, masks, cameras = {}, {}, {}
    for i, name in enumerate(names):
        s0 = 0.4 + 0.25 * smooth(rng)
        stokes[name] = np.stack([s0, 0.3 * s0 * smooth(rng), 0.3 * s0 * smooth(rng)], 2).astype(np.float16).astype(np.float32)
        mask = np.zeros((HEIGHT, WIDTH), bool)
        mask[4 + i : 18, 6:25] = True
        masks[name] = mask
        a = 0.7 * i + 0.2
        turn = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        tilt = np.array([[1, 0, 0], [0, np.cos(0.3), -np.sin(0.3)], [0, np.sin(0.3), np.cos(0.3)]])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = tilt @ turn, [0.1 * i, -0.2, 4.0]
        cameras[name] = Camera(WIDTH, HEIGHT, 40.0, 41.0, 15.5, 12.5, pose)
    return Scene(names, stokes, masks, cameras)


def write_masks(folder: Path, scene: Scene) -> None:
    for name, mask in scene.masks.items():
        write_mask(folder / f"{name}.png", mask)


def frame(pose: Camera, file: str, **more: object) -> dict:
    return {"file_path": file, "transform_matrix": opengl_from_camera(pose.world_to_camera).tolist(), "w": pose.width,
            "h": pose.height, "fl_x": pose.fx, "fl_y": pose.fy, "cx": pose.cx, "cy": pose.cy, **more}  # fmt: skip


def phygap_mitsuba(root: Path, scene: Scene) -> None:
    for name in scene.names:
        write_stokes(root / "images_full" / f"{name}.exr", scene.stokes[name], half=True)
    write_masks(root / "masks", scene)
    k = scene.cameras[scene.names[0]].intrinsics
    poses = np.stack([scene.cameras[n].world_to_camera for n in scene.names])
    np.savez(root / "camera_params.npz", intrinsics=k, extrinsics=poses, image_width=WIDTH, image_height=HEIGHT, fov=43.6)


def stokes_transforms(root: Path, scene: Scene) -> None:
    for name in scene.names:
        write_stokes(root / "images" / f"{name}.exr", scene.stokes[name], half=True)
    write_masks(root / "masks", scene)
    frames = [frame(scene.cameras[n], f"images/{n}.exr", mask_path=f"masks/{n}.png") for n in scene.names]
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))


def polarisers_transforms(root: Path, scene: Scene) -> None:
    """One file per view, cameras A and B in turn at 20 and 100 degrees, each in its folder."""
    frames = []
    for i, name in enumerate(scene.names):
        camera = "AB"[i % 2]
        rgb = scene.intensity(name, (20.0, 100.0)[i % 2])
        write_exr(root / "images" / camera / f"{name}.exr", {c: rgb[..., k] for k, c in enumerate("RGB")})
        frames.append(frame(scene.cameras[name], f"images/{camera}/{name}.exr", camera=camera))
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))


def world_mats(scene: Scene) -> dict[str, np.ndarray]:
    out = {}
    for i, name in enumerate(scene.names):
        matrix = np.eye(4)
        matrix[:3] = scene.cameras[name].intrinsics @ scene.cameras[name].world_to_camera[:3]
        out[f"world_mat_{i}"], out[f"scale_mat_{i}"] = matrix, np.diag([1.5, 1.5, 1.5, 1.0])
    return out


def pandora(root: Path, scene: Scene) -> None:
    for name in scene.names:
        s0, s1, s2 = 2 * np.moveaxis(scene.stokes[name], 2, 0)
        for part, image in (("s0", s0), ("s0p1", s0 + s1), ("s0p2", s0 + s2)):
            write_rgb(root / "images_stokes" / f"{name}_{part}.hdr", image)
    write_masks(root / "masks", scene)
    np.savez(root / "cameras.npz", **world_mats(scene))


def smvp3d(root: Path, scene: Scene) -> None:
    for k in range(3):
        (root / f"s{k}").mkdir(parents=True)
        for name in scene.names:
            np.save(root / f"s{k}" / f"{name}.npy", 2 * scene.stokes[name][:, :, k])
    write_masks(root / "mask", scene)
    np.savez(root / "cameras.npz", **world_mats(scene))


def rmvp3d(root: Path, scene: Scene) -> None:
    (root / "images_stokes").mkdir(parents=True)
    for name in scene.names:
        np.savez(root / "images_stokes" / f"{name}.npz", **{f"S{k}": 2 * scene.stokes[name][:, :, k] for k in range(3)})
    write_masks(root / "mask", scene)
    np.savez(root / "cameras.npz", **world_mats(scene))


def colmap_text(folder: Path, cameras: dict[str, Camera]) -> None:
    from stages.calib.poses.write import write_sparse

    write_sparse(folder, cameras)


def angle_stack(root: Path, scene: Scene) -> None:
    for name in scene.names:
        for angle in (0, 45, 90, 135):
            rgb = scene.intensity(name, angle)
            write_exr(root / "images" / f"{name}_{angle:03d}.exr", {c: rgb[..., k] for k, c in enumerate("RGB")})
    write_masks(root / "masks", scene)
    colmap_text(root / "sparse" / "0", scene.cameras)


def two_camera(root: Path, scene: Scene) -> None:
    for camera, angle in (("lp0", 20.0), ("lp1", 100.0)):
        for name in scene.names:
            write_rgb(root / camera / "images" / f"{name}.exr", scene.intensity(name, angle))
        write_masks(root / camera / "masks", scene)
        colmap_text(root / camera / "sparse" / "0", {f"{n}.exr": c for n, c in scene.cameras.items()})


@pytest.fixture
def write():
    """The writers by layout name."""
    return SimpleNamespace(phygap_mitsuba=phygap_mitsuba, stokes_transforms=stokes_transforms, pandora=pandora, rmvp3d=rmvp3d,
                           polarisers_transforms=polarisers_transforms, smvp3d=smvp3d, angle_stack=angle_stack,
                           two_camera=two_camera, colmap_text=colmap_text, masks=write_masks, frame=frame)  # fmt: skip
