"""Every view of a trained model under every map, from its G-buffer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.backdrop import grown
from pipeline.formats.gbuffer import read_gbuffer
from pipeline.formats.images import read_mask, srgb_encode, write_png, write_stokes
from pipeline.geometry.cameras import Camera, load_cameras

from .deferred import Lamp, ShadingModel, Surface
from .environment_map import read_map
from .indirect import indirect_light

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
    g = read_gbuffer(path)
    height, width = g.alpha.shape
    camera = camera.resized(width, height)
    shown = (g.alpha > LEAST_ALPHA) & (np.linalg.norm(g.normal, axis=-1) > 0.5)
    if mask is not None and mask.exists():
        inside = read_mask(mask)
        if inside.shape == shown.shape:
            shown &= grown(inside)
    index = np.flatnonzero(shown)
    rays = camera.rays()
    frame_x, frame_y = camera.stokes_frame()
    along = rays @ camera.world_to_camera[2, :3]  # z of a unit ray
    position = camera.centre + rays * (g.depth / along)[..., None]
    images = (position, g.normal, -rays, g.material, frame_x, frame_y)
    position, normal, view, material, frame_x, frame_y = (v.reshape(-1, v.shape[-1])[index] for v in images)
    surface = Surface(position, normal, view, material, frame_x, frame_y, index)
    return ViewPixels((height, width), index, g.alpha.ravel()[index], surface)


def relight_views(run: StageRun) -> None:
    """Write ENV/VIEW.exr and .png for every view and map, and turntables when asked.

    Views are the outer loop: a view's G-buffer is read, and its rays are cast, once for all maps.
    """
    p = run.parameters
    train = run.inputs["train"]
    cameras = load_cameras(run.inputs["poses"] / files.CAMERAS)
    paths = {v: files.gbuffer(train, v) for v in sorted(cameras)}
    paths = {v: q for v, q in paths.items() if q.exists()}
    if not paths:
        raise UserError(train / files.GBUFFERS, "there are no G-buffers", "run the train stage again")
    model = ShadingModel.read(train / files.LIGHTING, run.capture.up, p.mirror)
    lamps = {environment_name(path): _lamp(run, path, model) for path in run.environments}
    occluder = indirect_light(run, model)
    lit = {name: occluder.under(lamp) for name, lamp in lamps.items()} if occluder else {}
    masks = run.inputs.get("masks")
    with run.progress.bar("relighting", total=len(lamps) * len(paths), unit="images") as bar:
        for view, gbuffer in paths.items():
            pixels = read_view(gbuffer, cameras[view], files.mask(masks, view) if masks else None)
            attachment = occluder.attach(pixels.surface, p.shadow_rays == "pixel", view) if occluder else None
            for name, lamp in lamps.items():
                occlusion = occluder.at(attachment, lit[name]) if occluder and attachment is not None else None
                stokes = pixels.image(lamp.stokes(pixels.surface, occlusion))
                write_stokes(files.relit(run.output / name, view), stokes)
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
