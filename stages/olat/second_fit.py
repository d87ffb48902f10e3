"""The fits redone once with the object's own surface, which the first ones tell: lights and shadows of each pixel from it."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from pathlib import Path
from typing import Any

from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.ply import write_ply
from pipeline.rig.surface.read_maps import Rig
from pipeline.rig.surface.search import SurfaceSettings, find_surface
from stages.olat.known_geometry import KnownGeometry
from stages.olat.reading.stream import reading
from stages.olat.run import run as fit_all

SURFACE = "surface.ply"
FIRST, TOLD = "first", "first.json"
"""In the scratch folder: the first fits' maps, whole or not there, and what was told of them."""


@dataclasses.dataclass
class _Quiet(StageRun):
    """The first fits: what they would tell is kept, as the second ones tell the same again."""

    def warn(self, text: str) -> None:
        self.warnings.append(text)


def fit_twice(stage: StageRun) -> None:
    """Fit, find the surface on which the cameras agree, fit again with it; a killed run goes on after what was whole.

    Where the first fits show no surface they stay, and the manifest says why. Raises UserError as the fits do.
    """
    surface = stage.scratch / SURFACE
    if not surface.is_file():
        first = _first_fits(stage)
        stage.progress.say("olat: looking for the surface, to fit again with it")
        try:
            _write_surface(stage, first, surface)
        except UserError as error:
            _keep_first(stage, first, str(error))
            return
    with reading(stage) as lanes:
        fit_all(stage, lanes, surface)
    stage.note("second fit", {"run": True, "reason": "with the surface that the first fits show"})


def _first_fits(stage: StageRun) -> Path:
    """The folder of the first fits' maps, made now unless an earlier leg of this run left it whole."""
    whole, part = stage.scratch / FIRST, stage.scratch / f"{FIRST}.part"
    if whole.is_dir():
        return whole
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    solver = stage.parameters.solver if stage.parameters.solver in ("closed", "gradient") else "closed"
    own: dict[str, Any] = {f.name: getattr(stage, f.name) for f in dataclasses.fields(StageRun)}
    parameters = dataclasses.replace(stage.parameters, solver=solver)
    first = _Quiet(**{**own, "output": part, "parameters": parameters, "warnings": [], "facts": {}})
    with reading(first) as lanes:
        fit_all(first, lanes)
    (stage.scratch / TOLD).write_text(json.dumps({"warnings": first.warnings, "facts": first.facts}))
    os.replace(part, whole)
    return whole


def _write_surface(stage: StageRun, first: Path, path: Path) -> None:
    """Find the surface from the first fits' maps. Raises UserError where there is none that fills the cameras' masks."""
    rig = Rig(stage.capture.root, stage.inputs["decode"], first, stage.inputs.get("masks"))
    mesh, _ = find_surface(rig, SurfaceSettings(), lambda text: None)
    part = path.with_suffix(".part.ply")
    write_ply(part, dict(zip("xyz", mesh.vertices.T.astype("float32"))), mesh.faces)
    geometry = KnownGeometry(part)
    for maps in rig:
        geometry.covered(maps.camera, maps.mask > 0.5)
    os.replace(part, path)


def _keep_first(stage: StageRun, first: Path, why: str) -> None:
    """The first fits as the stage's own, with what they had to tell."""
    shutil.copytree(first, stage.output, dirs_exist_ok=True)
    told = json.loads((stage.scratch / TOLD).read_text())
    stage.facts.update(told["facts"])
    for text in told["warnings"]:
        stage.warn(text)
    stage.note("second fit", {"run": False, "reason": why})
