"""Every view of a trained model under every map, from its G-buffer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.images import srgb_encode, write_png, write_stokes
from pipeline.geometry.cameras import load_cameras, world_offset

from .deferred import Lamp, ShadingModel, Surface
from .environment_map import read_map
from .given_files import given_file
from .indirect import Indirect, indirect_light, traced
from .lighting import Lighting, MapLighting
from .lights_file import moved, read_lights
from .mesh_images import BakedMesh
from .placed_lights import PlacedLighting
from .turntable import write_moving_pictures
from .view_pixels import read_view


def relight_views(run: StageRun) -> None:
    """Write ENV/VIEW.exr and .png for every view and map, and moving pictures when asked.

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
    occluder = indirect_light(run, model)
    lights: dict[str, Lighting] = {environment_name(q): MapLighting(_lamp(run, q, model), occluder) for q in run.environments}
    if (placed := given_file(run.capture, p.lights, "relight.lights")) is not None:
        standing = moved(read_lights(placed), world_offset(run.inputs["poses"] / files.CAMERAS))
        lights[environment_name(placed)] = PlacedLighting(standing, model, traced(run, model, occluder))
    masks = run.inputs.get("masks")
    mesh = BakedMesh(run.inputs["mesh"] / files.MESH) if "mesh" in run.inputs else None
    with run.progress.bar("relighting", total=len(lights) * len(paths), unit="images") as bar:
        for view, gbuffer in paths.items():
            pixels = read_view(gbuffer, cameras[view], files.mask(masks, view) if masks else None, mesh)
            surfaces = [pixels.surface] + ([pixels.outlines.surface] if pixels.outlines else [])
            ties = Ties(surfaces, p.shadow_rays == "pixel", view)
            for name, lighting in lights.items():
                image = pixels.image(*(lighting.of_view(s, tie) for s, tie in zip(surfaces, ties.to(lighting.occluder))))
                write_stokes(files.relit(run.output / name, view), image)
                if p.previews:
                    write_png(run.output / name / f"{view}.png", srgb_encode(image[:, :, 0]))
                bar.advance(1)
    write_moving_pictures(run, cameras, lights, mesh, given_file(run.capture, p.cameras, "relight.cameras"))


class Ties:
    """A view's surfaces, tied to each occluder once, for all lights.

    own_rays: cast rays of the surfaces' own points, too; view: its name.
    """

    def __init__(self, surfaces: Sequence[Surface], own_rays: bool, view: str) -> None:
        self._surfaces, self._own_rays, self._view = surfaces, own_rays, view
        self._made: dict[int, list[Any]] = {}

    def to(self, occluder: Indirect | None) -> list[Any]:
        """What an occluder's lights need of each surface; None of one without points, or where nothing is occluded."""
        if occluder is None:
            return [None] * len(self._surfaces)
        if id(occluder) not in self._made:
            self._made[id(occluder)] = [
                occluder.attach(s, self._own_rays, self._view) if len(s.position) else None for s in self._surfaces
            ]
        return self._made[id(occluder)]


def _lamp(run: StageRun, path: Path, model: ShadingModel) -> Lamp:
    radiance, faults = read_map(path)
    for fault in faults:
        run.warn(fault)
    return Lamp(radiance, run.parameters.cube, model)
