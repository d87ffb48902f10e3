"""Every view of a trained model under every map, from its G-buffer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.images import srgb_encode, write_png, write_stokes
from pipeline.geometry.cameras import load_cameras, world_offset

from .deferred import Lamp, ShadingModel
from .environment_map import read_map
from .given_files import given_file
from .lighting import Lighting, MapLighting
from .lights_file import moved, read_lights
from .mesh_images import BakedMesh
from .placed_lights import PlacedLighting
from .turntable import write_moving_pictures
from .view_pixels import read_view

if TYPE_CHECKING:
    from .mesh_shadows import SelfOcclusion


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
    occluder = _occluder(run, model)
    lights: dict[str, Lighting] = {environment_name(q): MapLighting(_lamp(run, q, model), occluder) for q in run.environments}
    if (placed := given_file(run.capture, p.lights, "relight.lights")) is not None:
        standing = moved(read_lights(placed), world_offset(run.inputs["poses"] / files.CAMERAS))
        lights[environment_name(placed)] = PlacedLighting(standing, model, occluder)
    masks = run.inputs.get("masks")
    mesh = BakedMesh(run.inputs["mesh"] / files.MESH) if "mesh" in run.inputs else None
    with run.progress.bar("relighting", total=len(lights) * len(paths), unit="images") as bar:
        for view, gbuffer in paths.items():
            pixels = read_view(gbuffer, cameras[view], files.mask(masks, view) if masks else None, mesh)
            surfaces = [pixels.surface] + ([pixels.outlines.seen.surface] if pixels.outlines else [])
            ties = [occluder.attach(s, p.shadow_rays == "pixel") if occluder and len(s.position) else None for s in surfaces]
            for name, lighting in lights.items():
                image = pixels.image(*(lighting.of_view(s, tie) for s, tie in zip(surfaces, ties)))
                write_stokes(files.relit(run.output / name, view), image)
                if p.previews:
                    write_png(run.output / name / f"{view}.png", srgb_encode(image[:, :, 0]))
                bar.advance(1)
    write_moving_pictures(run, cameras, lights, mesh, given_file(run.capture, p.cameras, "relight.cameras"))


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
    return SelfOcclusion(mesh / files.MESH, model)
