"""A light stage's cameras under every map: from the sum of the frames and from the fitted maps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.named_file import named_file
from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.formats.images import RGB, read_mask, srgb_encode, write_exr, write_png
from pipeline.geometry.cameras import Camera, camera_from_frame
from pipeline.rig.relighting import relight_frames, relight_maps, relighting_error

from .environment_map import read_map
from .light_samples import as_map
from .lights_file import read_lights


def relight_stage(run: StageRun) -> None:
    """Write ENV/camNN.exr (maps), ENV/camNN_olat.exr (frames) and ENV/camNN_error.exr (their difference), with previews.

    Cameras are the outer loop: a camera's frames are read once for all maps.
    """
    index_path = run.inputs["decode"] / "olat.json"
    index = json.loads(index_path.read_text())
    config = run.capture.config.olat
    names = sorted(index["cameras"])
    lights = {environment_name(path): _light(run, path) for path in run.environments}
    if (placed := named_file(run.capture, run.parameters.lights, "relight.lights")) is not None:
        lights[environment_name(placed)] = as_map(read_lights(placed), np.zeros(3), run.capture.up)
    with run.progress.bar("relighting", total=len(lights) * len(names), unit="images") as bar:
        for name in names:
            mask = _mask(run, name)
            sums = relight_frames(
                index, run.capture.root, name, list(lights.values()), mask,
                irradiance=config.irradiance, specular_factor=config.specular_factor, up=run.capture.up,
                decode_folder=index_path.parent,
            )  # fmt: skip
            camera = camera_from_frame({"file_path": name, **index["cameras"][name]["camera"]}, {}, index_path)
            for (environment, light), summed in zip(lights.items(), sums):
                _write(run, environment, name + files.SUMMED, summed)
                if "olat" in run.inputs and (run.inputs["olat"] / name).is_dir():  # a camera that saw no object has no maps
                    _relight_maps(run, environment, name, camera, light, summed, mask)
                bar.advance(1)


def _light(run: StageRun, path: Path) -> NDArray[np.float32]:
    radiance, faults = read_map(path)
    for fault in faults:
        run.warn(fault)
    return radiance


def _relight_maps(
    run: StageRun,
    environment: str,
    name: str,
    camera: Camera,
    light: NDArray[np.float32],
    summed: NDArray[np.float32],
    mask: NDArray[np.bool_] | None,
) -> None:
    """A camera's fitted maps under a map, and how far that is from the sum of its frames."""
    occlusion = run.parameters.indirect != "none"
    shaded = relight_maps(run.inputs["olat"] / name, camera, light, up=run.capture.up, occlusion=occlusion)
    _write(run, environment, name, shaded)
    inside = np.asarray(shaded.any(-1)) if mask is None else mask
    error = relighting_error(summed, shaded, inside)
    write_exr(files.relit(run.output / environment, name, files.ERROR), {"Y": error})
    if inside.any():
        run.note(f"{environment}.{name}.maps_error_median", round(float(np.median(error[inside])), 4))


def _mask(run: StageRun, name: str) -> NDArray[np.bool_] | None:
    folder = run.inputs.get("masks")
    path = files.mask(folder, name) if folder else None
    return read_mask(path) if path is not None and path.exists() else None


def _write(run: StageRun, environment: str, name: str, image: NDArray[np.float32]) -> None:
    write_exr(files.relit(run.output / environment, name), {c: image[..., k] for k, c in enumerate(RGB)})
    if run.parameters.previews:
        write_png(run.output / environment / f"{name}.png", srgb_encode(image))
