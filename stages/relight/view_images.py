"""Every view of a trained model under every map, from its G-buffer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.backdrop import grown
from pipeline.formats.images import read_image, read_mask, srgb_encode, write_png, write_stokes
from pipeline.geometry.cameras import Camera, load_cameras

from .deferred import Lamp, ShadingModel, Surface
from .maps import read_map

if TYPE_CHECKING:
    from .mesh_shadows import SelfOcclusion

CHANNELS = ("depth", "alpha", "N.X", "N.Y", "N.Z", "albedo.R", "albedo.G", "albedo.B", "roughness", "ior")
LEAST_ALPHA = 1 / 255  # below it nothing shows in any display


@dataclass(frozen=True)
class ViewPixels:
    """A view's shaded pixels: where they are, how opaque, and their surface."""

    size: tuple[int, int]  # height, width
    index: NDArray[np.int64]
    alpha: NDArray[np.float32]
    surface: Surface

    def image(self, stokes: NDArray) -> NDArray[np.float32]:
        """Stokes image [H, W, 3, 3], black where there is no object."""
        out = np.zeros((self.size[0] * self.size[1], 3, 3), np.float32)
        out[self.index] = np.nan_to_num(stokes) * self.alpha[:, None, None]
        return out.reshape(*self.size, 3, 3)


def read_view(path: Path, camera: Camera, mask: Path | None) -> ViewPixels:
    """A view's G-buffer as shaded pixels; outside the mask (and the pixel beside it, half covered) there are none."""
    a = read_image(path, CHANNELS)
    height, width = a.shape[:2]
    if (camera.height, camera.width) != (height, width):
        camera = camera.resized(width, height)
    shown = (a[..., 1] > LEAST_ALPHA) & (np.linalg.norm(a[..., 2:5], axis=-1) > 0.5)
    if mask is not None and mask.exists():
        inside = read_mask(mask)
        if inside.shape == shown.shape:
            shown &= grown(inside)
    index = np.flatnonzero(shown)
    rays = camera.rays()
    frame_x, frame_y = camera.stokes_frame()
    along = rays @ camera.world_to_camera[2, :3]  # z of a unit ray
    position = camera.centre + rays * (a[..., 0] / along)[..., None]
    flat = [v.reshape(-1, 3)[index] for v in (position, a[..., 2:5], -rays, frame_x, frame_y)]
    surface = Surface(flat[0], flat[1], flat[2], a.reshape(-1, len(CHANNELS))[index, 5:10], flat[3], flat[4])
    return ViewPixels((height, width), index, a[..., 1].ravel()[index], surface)


def relight_views(run: StageRun) -> None:
    """Write ENV/VIEW.exr and .png for every view and map, and turntables when asked.

    Views are the outer loop: a view's G-buffer is read, and its rays are cast, once for all maps.
    """
    p = run.parameters
    train = run.inputs["train"]
    cameras = load_cameras(run.inputs["poses"] / "cameras.json")
    paths = {v: train / "gbuffer" / f"{v}.exr" for v in sorted(cameras)}
    paths = {v: q for v, q in paths.items() if q.exists()}
    if not paths:
        raise UserError(train / "gbuffer", "there are no G-buffers", "run the train stage again")
    model = ShadingModel.read(train / "lighting.json", run.capture.up, p.mirror)
    lamps = {environment_name(path): _lamp(run, path, model) for path in run.environments}
    occluder = _occluder(run, model)
    lit = {name: occluder.under(lamp) for name, lamp in lamps.items()} if occluder else {}
    masks = run.inputs.get("masks")
    with run.progress.bar("relighting", total=len(lamps) * len(paths), unit="images") as bar:
        for view, gbuffer in paths.items():
            pixels = read_view(gbuffer, cameras[view], masks / f"{view}.png" if masks else None)
            attachment = occluder.attach(pixels.surface, p.shadow_rays == "pixel") if occluder else None
            for name, lamp in lamps.items():
                occlusion = occluder.at(attachment, lit[name]) if occluder and attachment else None
                stokes = pixels.image(lamp.stokes(pixels.surface, occlusion))
                write_stokes(run.output / name / f"{view}.exr", stokes)
                if p.previews:
                    write_png(run.output / name / f"{view}.png", srgb_encode(stokes[:, :, 0]))
                bar.advance(1)
    if p.turntable:
        from .turntable import write_turntable

        for name, lamp in lamps.items():
            received = occluder.on_mesh(lit[name]) if occluder else None
            write_turntable(run, lamp, cameras, run.output / name, received)


def _lamp(run: StageRun, path: Path, model: ShadingModel) -> Lamp:
    radiance, faults = read_map(path)
    for fault in faults:
        run.warn(fault)
    return Lamp(radiance, run.parameters.cube, model)


def _occluder(run: StageRun, model: ShadingModel) -> SelfOcclusion | None:
    """What shadows the model throws on itself, or None where they are off."""
    wanted = run.parameters.occlusion == "on" or (run.parameters.occlusion == "auto" and model.occlusion)
    mesh = run.inputs.get("mesh")
    if not wanted or mesh is None:
        reason = "relight.occlusion=off" if run.parameters.occlusion == "off" else "training saw no self-occlusion"
        run.note("occlusion", {"run": False, "reason": reason})
        return None
    from .mesh_shadows import SelfOcclusion

    run.note("occlusion", {"run": True, "reason": "the object occludes itself: shadows and bounces from the mesh"})
    return SelfOcclusion(mesh / "mesh.ply", model)
