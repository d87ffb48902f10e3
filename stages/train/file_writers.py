"""What training leaves: test views, G-buffers, the Gaussians for viewers, the environment, the polarisers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from pipeline.formats.gbuffer import NORMAL, PARTS, SurfaceImage, channels_of
from pipeline.formats.images import RGB, STOKES, write_exr, write_rgb
from pipeline.formats.ply import write_ply
from pipeline.geometry.world_offset import ply_comment

from .render_view import Rendered
from .splats.gaussians import SplatModel, to_numpy
from .views.polarisers import PolariserBank
from .views.training_frame import SceneFrame
from .views.view import View

SH_C0 = 0.28209479177387814  # zeroth spherical harmonic: viewers show 0.5 + SH_C0 * f_dc


def surface_image(rendered: Rendered, view: View, frame: SceneFrame) -> SurfaceImage:
    """Normal, material, opacity and depth images of a view (world axes and units), 0 where there is no object."""
    g = rendered.gbuffer
    height, width = view.size
    index = view.pixels.cpu().numpy()
    there = g.alpha.cpu().numpy() > 1 / 255

    def image(values: np.ndarray) -> np.ndarray:
        out = np.zeros((height * width, values.shape[-1]), np.float32)
        out[index[there]] = values[there]
        return out.reshape(height, width, -1)

    material = np.concatenate([g.albedo.cpu().numpy(), g.roughness.cpu().numpy()[:, None], g.ior.cpu().numpy()[:, None]], -1)
    return SurfaceImage(
        normal=image(frame.directions_to_world(g.normal.cpu().numpy())),
        material=image(material),
        alpha=g.alpha_image.cpu().numpy(),
        depth=np.asarray(g.raster.depth_median.cpu().numpy() * frame.scale, np.float32),
    )


def view_channels(rendered: Rendered, view: View, frame: SceneFrame) -> dict[str, np.ndarray]:
    """Everything of a test view: Stokes, G-buffer, and the diffuse and specular parts of s0, in the capture's radiance."""
    height, width = view.size
    index = view.pixels.cpu().numpy()
    alpha = rendered.gbuffer.alpha[:, None].cpu()

    def image(values: torch.Tensor) -> np.ndarray:
        flat = np.zeros((height * width, values.shape[-1]), np.float32)
        flat[index] = np.nan_to_num(values.cpu().numpy()) / frame.exposure
        return flat.reshape(height, width, -1)

    stokes = image(rendered.stokes.reshape(len(index), 9))
    channels = {name: stokes[..., k] for k, name in enumerate(STOKES)}
    for part, values in zip(PARTS, (rendered.shaded.diffuse, rendered.shaded.specular)):
        rgb = image(values.cpu() * alpha)
        channels |= {f"{part}.{c}": rgb[..., k] for k, c in enumerate("RGB")}
    return channels | channels_of(surface_image(rendered, view, frame))


def write_learnt_light(path: Path, rendered: Rendered, view: View, frame: SceneFrame) -> None:
    """Radiance that a view's surface mirrors of the object itself, as learnt (`train.indirect=sh`), in the capture's: R G B."""
    height, width = view.size
    flat = np.zeros((height * width, 3), np.float32)
    flat[view.pixels.cpu().numpy()] = np.nan_to_num(rendered.gbuffer.extra.cpu().numpy()) / frame.exposure
    write_exr(path, {c: flat[:, k].reshape(height, width) for k, c in enumerate(RGB)})


def with_normals(
    channels: dict[str, np.ndarray], normals: torch.Tensor, view: View, frame: SceneFrame
) -> dict[str, np.ndarray]:
    """The channels with these normals [P, 3] of the view's counting pixels (`render_view.mean_normals`) where there are any."""
    found = normals.cpu().numpy()
    there = (found != 0).any(-1)
    rows = view.pixels.cpu().numpy()[there]
    world = frame.directions_to_world(found[there])
    out = dict(channels)
    for k, name in enumerate(NORMAL):
        flat = channels[name].reshape(-1).copy()
        flat[rows] = world[:, k]
        out[name] = flat.reshape(view.size)
    return out


def with_inner_sides(channels: dict[str, np.ndarray], coverage: torch.Tensor) -> dict[str, np.ndarray]:
    """The channels with an alpha that counts inner sides, seen through openings, too: `coverage` [H, W] by them."""
    return {**channels, "alpha": np.maximum(channels["alpha"], coverage.cpu().numpy())}


def write_gaussians(path: Path, model: SplatModel, frame: SceneFrame, offset: np.ndarray | None = None) -> None:
    """Write gaussians.ply as 3DGS and 2DGS viewers read it: raw opacity (logit), log scales, wxyz quaternions.

    path: the file; model: in the training frame; frame: the way back to the capture's world; offset [3]: was taken from all
    world positions (`pipeline.geometry.world_offset`), and a comment tells it.

    A third, very small scale makes viewers that know only 3D Gaussians show discs.
    """
    values = to_numpy(model.activated())
    count = len(values["means"])
    rotation = frame.train_from_world.T
    positions = frame.points_to_world(values["means"].astype(np.float64))
    normals = frame.directions_to_world(values["normals"].astype(np.float64))
    quaternions = _rotated(values["quaternions"].astype(np.float64), rotation)
    scales = np.log(values["scales"].astype(np.float64) * frame.scale)
    opacity = np.clip(values["opacities"].astype(np.float64), 1e-6, 1 - 1e-6)
    columns: dict[str, np.ndarray] = {}
    for k, c in enumerate("xyz"):
        columns[c] = positions[:, k]
    for k, c in enumerate("xyz"):
        columns[f"n{c}"] = normals[:, k]
    display = np.clip(values["albedo"], 0, 1) ** (1 / 2.2)
    for k in range(3):
        columns[f"f_dc_{k}"] = (display[:, k] - 0.5) / SH_C0
    columns["opacity"] = np.log(opacity / (1 - opacity))
    columns["scale_0"], columns["scale_1"] = scales[:, 0], scales[:, 1]
    columns["scale_2"] = np.full(count, float(scales.min()) - 4.0) if count else np.zeros(0)
    for k in range(4):
        columns[f"rot_{k}"] = quaternions[:, k]
    for k, c in enumerate("rgb"):
        columns[f"albedo_{c}"] = values["albedo"][:, k]
    columns["ior"], columns["roughness"] = values["ior"], values["roughness"]
    write_ply(path, columns, comments=ply_comment(offset))


def _rotated(quaternions: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Quaternions wxyz after a world rotation (a proper one; the up-axis turns all are)."""
    from scipy.spatial.transform import Rotation

    if np.linalg.det(rotation) < 0:
        raise ValueError("a reflection is not a rotation")
    q = (Rotation.from_matrix(rotation) * Rotation.from_quat(quaternions, scalar_first=True)).as_quat(scalar_first=True)
    return np.where(q[:, :1] < 0, -q, q)


def write_environment(path: Path, radiance: torch.Tensor, frame: SceneFrame, height: int = 256) -> None:
    """env.exr: latitude-longitude, linear, y up, in the capture's radiance. The training frame is y up already."""
    from pipeline.shading import latlong

    cube = radiance.detach().cpu().double().numpy() / frame.exposure
    image = latlong.from_cube(cube, height, 2 * height)
    write_rgb(path, np.maximum(image, 0).astype(np.float32))


def write_polarisers(path: Path, bank: PolariserBank | None) -> None:
    """polarisers.json: {} where the capture has none."""
    table = {}
    for name, state in (bank.result() if bank is not None else {}).items():
        values = asdict(state)
        table[name] = {k: values[k] for k in ("angle_deg", "std_deg", "trusted")}
    path.write_text(json.dumps(table, indent=1) + "\n")


def write_lighting(path: Path, frame: SceneFrame, facts: Mapping[str, object]) -> None:
    """lighting.json: the scene's frame and how it was shaded, for relighting with the same model."""
    path.write_text(json.dumps({"schema": 1, "frame": frame.as_json(), **facts}, indent=1) + "\n")
