"""A light stage's maps beside the views, as training compares with them: in its frame, at pixels of its size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.asset.lobes import of_another_lobe
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.geometry.cameras import Camera, world_offset
from pipeline.geometry.world_offset import less
from pipeline.optics.model_names import Distribution
from pipeline.rig.surface.read_maps import Rig, RigMaps

from .source_views import SourceView
from .training_frame import SceneFrame
from .view import COVERED, View, prepare

NORMAL_FLOOR = 1.0  # degrees to which splats a pixel apart follow a measured normal, however little noise it has
ALBEDO_FLOOR, ROUGHNESS_FLOOR = 0.03, 0.02  # the same of albedos, relative, and of roughnesses
FEWEST_PIXELS = 20  # of a camera that is of any use


@dataclass(frozen=True)
class MapPixels:
    """One camera's maps at the P pixels that training compares, all in the training frame.

    Attributes:
        view: the camera, with its counting pixels.
        normal: unit. [P, 3]
        albedo: diffuse, in the light stage's own unit. [P, 3]
        roughness: of training's lobe. [P]
        normal_weight, albedo_weight, roughness_weight: 1 where noise is nothing beside the floors, 0 where none is known. [P]
    """

    view: View
    normal: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    normal_weight: torch.Tensor
    albedo_weight: torch.Tensor
    roughness_weight: torch.Tensor


def read_map_pixels(stage: StageRun, frame: SceneFrame, pixel: float) -> list[MapPixels]:
    """Every camera's maps.

    Args:
        stage: the run; none is read without `inputs["olat"]`.
        frame: the training frame.
        pixel: a training pixel's width on the object, training units; cameras that see finer are averaged to about that.

    Returns:
        The cameras that show anything of the object.

    Raises:
        UserError: maps that cannot be read.
    """
    beside = stage.of_light_stage()
    rig = Rig(beside.capture.root, beside.inputs["decode"], beside.inputs["olat"], beside.inputs.get("masks"), fewest=1)
    offset = world_offset(beside.inputs["poses"] / files.CAMERAS)
    found = []
    for maps in rig:
        camera = less(maps.camera, offset)
        own = frame.camera(camera)
        factor = max(1, round(pixel * max(own.fx, own.fy) / float(np.linalg.norm(own.centre))))
        pixels = map_pixels(replace(maps, camera=camera), rig.lobe, stage.parameters.lobe, frame, factor, stage.device)
        if len(pixels.view.pixels) >= FEWEST_PIXELS:
            found.append(pixels)
    return found


def map_pixels(
    maps: RigMaps, lobe: str, wanted: Distribution, frame: SceneFrame, factor: int = 1, device: str = "cpu"
) -> MapPixels:
    """What one camera's maps say at blocks of factor x factor pixels that the object covers wholly.

    Args:
        maps: the camera's, its world that of the views.
        lobe: that the widths are of (`pipeline.rig.lobe_names`).
        wanted: training's lobe.
        frame: the training frame.
        factor: side of a block, pixels.
        device: torch device of the tensors.
    """
    m = maps.maps
    sigma = np.maximum(m["sigma"], 1e-6)
    wide = np.sqrt(sigma[..., :1] * sigma[..., 1:])  # alpha of the round lobe as wide
    grey = np.maximum(m["diffuse_albedo"].mean(-1, keepdims=True), 1e-6)
    roughness = np.sqrt(wide)
    sound, lobed = maps.sound[..., None], maps.lobed[..., None]
    shares = {
        "normal": sound * share_of(m["std_diffuse_normal"], NORMAL_FLOOR),
        "albedo": sound * share_of(m["std_diffuse_albedo"] / grey, ALBEDO_FLOOR),
        "roughness": lobed * share_of(0.5 * roughness * m["std_sigma"] / wide, ROUGHNESS_FLOOR),
    }
    values = {
        "normal": m["normal"] @ frame.train_from_world.T,
        "albedo": m["diffuse_albedo"],
        "roughness": of_another_lobe(roughness, lobe, wanted),
    }
    weight = {name: block_mean(share, factor) for name, share in shares.items()}
    mean = {n: block_mean(values[n] * shares[n], factor) / np.maximum(weight[n], 1e-9) for n in values}
    length = np.linalg.norm(mean["normal"], axis=-1, keepdims=True)
    mean["normal"] = mean["normal"] / np.maximum(length, 1e-9)
    covered = block_mean(maps.mask[..., None], factor)[..., 0]
    known = (covered > COVERED) & ((weight["normal"] > 0) | (weight["albedo"] > 0))[..., 0]
    image = np.zeros((*covered.shape, 1, 3), np.float32)
    source = SourceView(maps.name, "left_out", in_blocks(maps.camera, covered.shape, factor), image, covered, known)
    view = prepare(source, frame, black=False, device=device)
    index = view.pixels.cpu().numpy()

    def picked(array: NDArray, channels: int) -> torch.Tensor:
        rows = np.ascontiguousarray(array.reshape(-1, channels)[index], np.float32)
        return torch.as_tensor(rows if channels > 1 else rows[:, 0], device=device)

    return MapPixels(
        view, picked(mean["normal"], 3), picked(mean["albedo"], 3), picked(mean["roughness"], 1),
        *(picked(weight[name], 1) for name in ("normal", "albedo", "roughness")),
    )  # fmt: skip


def share_of(deviation: NDArray, floor: float) -> NDArray:
    """What a value of this standard deviation counts beside one without noise, which is uncertain by `floor`."""
    return floor**2 / (np.asarray(deviation, np.float64) ** 2 + floor**2)


def block_mean(image: NDArray, factor: int) -> NDArray[np.float32]:
    """Means [h, w, C] over blocks of factor x factor pixels of an image [H, W, C]; what sticks out counts as 0."""
    height, width = (-(-n // factor) for n in image.shape[:2])
    whole = np.pad(image, [(0, height * factor - image.shape[0]), (0, width * factor - image.shape[1]), (0, 0)])
    return whole.reshape(height, factor, width, factor, -1).mean((1, 3)).astype(np.float32)


def in_blocks(camera: Camera, shape: tuple[int, ...], factor: int) -> Camera:
    """The camera whose pixels are blocks of another's; the last ones may stick out."""
    return replace(
        camera, width=shape[1], height=shape[0], fx=camera.fx / factor, fy=camera.fy / factor,
        cx=camera.cx / factor, cy=camera.cy / factor,
    )  # fmt: skip
