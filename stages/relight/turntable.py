"""A turntable of the mesh under one map, by ray casting with the baked vertex attributes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.formats.dataset_files import MESH, TURNTABLE
from pipeline.formats.images import srgb_encode, write_png
from pipeline.formats.ply import Ply
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rays import RayMesh
from pipeline.geometry.world import Y_UP_FROM

from .deferred import Lamp, Surface

SUPERSAMPLE = 2  # rays across a pixel
FRAME_MS = 60
ATTRIBUTES = ("nx", "ny", "nz", "albedo_r", "albedo_g", "albedo_b", "roughness", "ior")


class TexturedMesh:
    """The mesh with its vertex attributes, ready for rays."""

    def __init__(self, path: Path) -> None:
        vertices, self.attributes, self.faces = read_baked_mesh(path)
        self.low, self.high = vertices.min(0), vertices.max(0)
        self._rays = RayMesh(vertices, self.faces)

    def hit(self, origin: NDArray, directions: NDArray, attributes: NDArray) -> tuple[NDArray[np.bool_], NDArray, NDArray]:
        """Rays from `origin` along `directions` [N, 3]: which hit, and position [M, 3], attributes [M, C] of those [V, C]."""
        found = self._rays.cast(origin, directions)
        hit = found.hit
        values = np.einsum("nk,nkc->nc", found.weights[hit], attributes[self.faces[found.triangle[hit]]])
        return hit, origin + directions[hit] * found.distance[hit, None], values


def read_baked_mesh(path: Path) -> tuple[NDArray, NDArray, NDArray]:
    """Vertices [V, 3], attributes [V, 8] and faces [F, 3] of a mesh.ply of the mesh stage. Raises UserError."""
    ply = Ply(path)
    return ply.vertices(), ply.vertices(ATTRIBUTES), ply.triangles()


def orbit(cameras: dict[str, Camera], centre: NDArray, up: str, count: int, size: int) -> list[Camera]:
    """Cameras around `centre` at the capture's median distance and elevation, with its widest field of view."""
    turn = Y_UP_FROM[up]
    offsets = np.stack([(c.centre - centre) @ turn.T for c in cameras.values()])
    distance = float(np.median(np.linalg.norm(offsets, axis=1)))
    elevation = float(np.median(np.arcsin(np.clip(offsets[:, 1] / np.linalg.norm(offsets, axis=1), -1, 1))))
    focal = min(c.fy / c.height for c in cameras.values()) * size
    out = []
    for k in range(count):
        azimuth = 2 * np.pi * k / count
        back = np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])
        right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
        rotation = np.stack([right, -np.cross(back, right), -back]) @ turn
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = -rotation @ (centre + distance * (back @ turn))
        out.append(Camera(size, size, focal, focal, size / 2, size / 2, pose))
    return out


def render(mesh: TexturedMesh, camera: Camera, lamp: Lamp, received: NDArray | None = None) -> NDArray[np.float32]:
    """Linear RGB [H, W, 3] of the mesh on black; `received` [V, 6] is the shadow and bounced light at its vertices."""
    fine = camera.resized(camera.width * SUPERSAMPLE, camera.height * SUPERSAMPLE)
    rays = fine.rays().reshape(-1, 3)
    frame_x, frame_y = (f.reshape(-1, 3) for f in fine.stokes_frame())
    attributes = mesh.attributes if received is None else np.concatenate([mesh.attributes, received], 1)
    hit, position, values = mesh.hit(fine.centre, rays, attributes)
    normal = values[:, :3] / np.linalg.norm(values[:, :3], axis=1, keepdims=True)
    surface = Surface(position, normal, -rays[hit], values[:, 3:8], frame_x[hit], frame_y[hit])
    occlusion = None if received is None else _diffuse_occlusion(values[:, 8:])
    image = np.zeros((len(rays), 3), np.float32)
    image[hit] = np.nan_to_num(lamp.stokes(surface, occlusion)[:, 0])
    blocks = image.reshape(camera.height, SUPERSAMPLE, camera.width, SUPERSAMPLE, 3)
    return blocks.mean((1, 3))


def _diffuse_occlusion(values: NDArray) -> Any:
    """Shadow and bounced light as shading takes them; reflections go free."""
    import torch

    from pipeline.shading import Occlusion

    both = torch.as_tensor(np.ascontiguousarray(values, np.float32))
    ones = torch.ones(len(values))
    return Occlusion(both[:, :3].contiguous(), both[:, 3:].contiguous(), ones, torch.zeros(len(values), 3))


def write_turntable(
    run: StageRun, lamp: Lamp, cameras: dict[str, Camera], folder: Path, received: NDArray | None = None
) -> None:
    """turntable/NNN.png and turntable.webp of one map; `received` [V, 6] as `render` takes it."""
    from PIL import Image

    if "mesh" not in run.inputs:
        run.warn("there is no mesh, so no turntable; check that the mesh stage ran")
        return
    mesh = TexturedMesh(run.inputs["mesh"] / MESH)
    centre = (mesh.low + mesh.high) / 2
    p = run.parameters
    frames = []
    with run.progress.bar("turntable", total=p.turntable, unit="frames") as bar:
        for k, camera in enumerate(orbit(cameras, centre, lamp.model.up, p.turntable, p.turntable_size)):
            shown = (srgb_encode(render(mesh, camera, lamp, received)) * 255 + 0.5).astype(np.uint8)
            write_png(folder / "turntable" / f"{k:03d}.png", shown)
            frames.append(Image.fromarray(shown))
            bar.advance(1)
    frames[0].save(folder / TURNTABLE, save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, quality=85)
