"""What the viewer shows of a light stage: each camera's fitted maps, pixel by pixel, for a light that the pointer moves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.formats.arrays import read_array
from pipeline.formats.images import RGB, XYZ, read_image
from pipeline.geometry.cameras import Camera, camera_from_frame
from pipeline.report.pictures import INFERNO, VIRIDIS, crop_box, evenly_chosen
from pipeline.rig import lobes
from pipeline.rig.kept_samples import read_kept_samples
from pipeline.rig.lobe_names import LOBES
from pipeline.rig.lobe_points import LIGHT_FLOOR

from .fit_data import ANGLES, NOTHING, Shown, directions_or_nothing, fit_entry, halves, most_pixels
from .packing import octahedral, packed

PIXELS = 280_000
"""Of all cameras together: about 7 MB in the page. Beyond it every 2nd, 3rd, ... pixel of a camera is taken."""
MOST = 24  # cameras
SIGMA_SHOWN = 0.6  # end of its colour scale, as in the report's pictures


def rig_scene(run: StageRun) -> dict[str, Any] | None:
    """The maps as `rig.js` takes them, or None where no camera has any."""
    if "olat" not in run.inputs or "decode" not in run.inputs:
        return None
    path = run.inputs["decode"] / "olat.json"
    index = json.loads(path.read_text())
    known = index["cameras"]
    folders = {f.name: f for f in files.subfolders(run.inputs["olat"]) if f.name in known}
    names = evenly_chosen(sorted(folders), MOST)
    lobe = LOBES[json.loads((run.inputs["olat"] / files.FITTED_LOBE).read_text())["lobe"]]
    shown = shown_samples(run, index, folders[names[0]], lobe) if names else None
    cameras = []
    for name in names:
        camera = camera_from_frame({"file_path": name, **known[name]["camera"]}, {}, path)
        entry = camera_entry(folders[name], camera, PIXELS // len(names))
        if entry is None:
            continue
        kept = folders[name] / files.KEPT_SAMPLES
        if shown is not None and kept.is_file():
            most, passes = most_pixels(len(shown.directions), len(names)), known[name].get("passes", "both")
            (top, left), step = entry["corner"], entry["step"]
            entry["fits"] = fit_entry(read_kept_samples(kept), camera, shown, passes, (top, left), step, most)
        cameras.append({"name": name, **entry})
    if not cameras:
        return None
    return scene_of(cameras, lobe, None if shown is None else shown.directions)


def shown_samples(run: StageRun, index: dict[str, Any], folder: Path, lobe: int) -> Shown | None:
    """What the kept samples are of; None where there are none, or near lights make it another thing in every pixel."""
    kept = folder / files.KEPT_SAMPLES
    olat, table = run.capture.one_light_at_a_time.config.olat, index["lights"]
    if olat.near_light or not kept.is_file():
        return None
    used = read_array(kept, "lights")
    light = olat.irradiance * np.array(table["intensity"])[:, None] * np.array(table.get("colour", [[1.0, 1.0, 1.0]]))
    return Shown(light[used], np.array(table["directions"])[used], olat.specular_factor, lobe)


def scene_of(cameras: list[dict[str, Any]], lobe: int, lights: NDArray[np.float64] | None = None) -> dict[str, Any]:
    """All that `rig.js` reads: cameras of `camera_entry` with their `name`; lobe of `LOBES`; directions to lights [L, 3]."""
    names = {f"LOBE_{name.replace('-', '_').upper()}": k for name, k in LOBES.items()}
    constants = {"PI": float(np.pi), "LOBE": lobe, "VIEW_FLOOR": lobes.VIEW_FLOOR, "LIGHT_FLOOR": float(LIGHT_FLOOR)}
    return {
        "kind": "rig",
        "lights": None if lights is None else packed(octahedral(lights)),
        "angles": ANGLES.tolist(),
        "cameras": cameras,
        "nothing": NOTHING,
        "constants": {**constants, "SIGMA_SHOWN": SIGMA_SHOWN, **names},
        "scales": {"inferno": INFERNO, "viridis": VIRIDIS},
    }


def camera_entry(folder: Path, camera: Camera, most: int) -> dict[str, Any] | None:
    """One camera's maps at the pixels of the object, every step-th where there are more than `most`; None without any.

    `size` of the cut picture, `inside` bytes [H, W], and for each pixel inside, row by row: `normal_d`, `normal_s`, `tangent`,
    `view` octahedral [P, 2] (world; view towards the camera), `albedo` [P, 3], and `lobe` [P, 3] (larger and smaller sigma,
    specular albedo) as half floats in uint16. `axes`: right, up, back of the camera [3][3], world.
    """
    normal = read_image(files.camera_map(folder, "diffuse_normal"), XYZ)
    there = np.linalg.norm(normal, axis=-1) > 0.5
    if not there.any():
        return None
    step = int(np.ceil(np.sqrt(max(1.0, there.sum() / most))))
    box = crop_box([there])
    cut = (slice(box[0].start, box[0].stop, step), slice(box[1].start, box[1].stop, step))
    inside = there[cut]

    def of(name: str, channels: tuple[str, ...]) -> NDArray:
        return np.nan_to_num(read_image(files.camera_map(folder, name), channels)[cut][inside])

    lobe = np.concatenate([of("sigma", ("X", "Y")), of("specular_albedo", ("Y",))], -1)
    right, down, ahead = camera.world_to_camera[:3, :3]
    return {
        "size": [inside.shape[1], inside.shape[0]], "step": step, "corner": [int(box[0].start), int(box[1].start)],
        "axes": [right.tolist(), (-down).tolist(), (-ahead).tolist()],
        "inside": packed(inside.astype(np.uint8)),
        "normal_d": packed(directions_or_nothing(of("diffuse_normal", XYZ))),
        "normal_s": packed(directions_or_nothing(of("specular_normal", XYZ))),
        "tangent": packed(directions_or_nothing(of("tangent", XYZ))), "view": packed(octahedral(-camera.rays()[cut][inside])),
        "albedo": packed(halves(of("diffuse_albedo", RGB))), "lobe": packed(halves(lobe)),
    }  # fmt: skip
