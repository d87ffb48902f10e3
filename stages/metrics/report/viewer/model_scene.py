"""What the viewer shows of a trained model: mesh, lights, cameras with photographs, words."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.geometry.world import Y_UP_FROM
from pipeline.report.pictures import AOLP_FULL, DOLP_FULL, INFERNO, VIRIDIS
from pipeline.shading import splitsum

from .light_data import light_entries, mirror_table
from .photographs import camera_entries
from .shading_constants import shading_constants
from .splat_data import splat_entry
from .surface_data import surface_entry

IOR_SHOWN = (1.3, 2.3)  # ends of its colour scale, as in the report's pictures


def model_scene(run: StageRun) -> dict[str, Any] | None:
    """The model as `model.js` takes it, or None where there is no mesh with its material."""
    if "mesh" not in run.inputs or "train" not in run.inputs or not (run.inputs["mesh"] / files.MESH).is_file():
        return None
    train = run.inputs["train"]
    path = train / files.LIGHTING
    lighting = json.loads(path.read_text()) if path.is_file() else {}
    turn = Y_UP_FROM[lighting.get("up", run.capture.up)]
    lobe = lighting.get("lobe", "ggx")
    relit = {f.name for f in files.subfolders(run.inputs["relight"])} if "relight" in run.inputs else set()
    maps = {environment_name(p): p for p in run.capture.environments}
    cameras, gain = camera_entries(run, turn)
    lights = light_entries(train / files.ENVIRONMENT, {n: p for n, p in sorted(maps.items()) if n in relit})
    mesh = run.inputs["mesh"]
    scene = scene_of(surface_entry(mesh / files.MESH, turn, mesh / files.ASSET), lights, lobe, turn, cameras, gain)
    splats = splat_entry(train / files.LIT_SPLATS, turn)
    return scene if splats is None else {**scene, "splats": splats}


def scene_of(
    surface: dict[str, Any],
    lights: list[dict[str, Any]],
    lobe: str,
    turn: NDArray[np.float64],
    cameras: list[dict[str, Any]],
    gain: float,
) -> dict[str, Any]:
    """All that `model.js` reads.

    surface, lights, cameras: of `surface_entry`, `light_entry`, `camera_entries`; lobe: "ggx" or "beckmann"; turn [3, 3]: from
    the capture's world to y up; gain: factor that the photographs were stored with.
    """
    return {
        "kind": "model",
        "surface": surface,
        "lights": lights,
        "lobe": lobe,
        "constants": shading_constants(),
        "mirror": mirror_table(lobe),
        "mirror_ior": splitsum.IOR_RANGE,
        "cameras": cameras,
        "gain": gain,
        "world_from_view": turn.T.tolist(),
        "scales": {"inferno": INFERNO, "viridis": VIRIDIS, "dolp": DOLP_FULL, "aolp": AOLP_FULL, "ior": IOR_SHOWN},
    }
