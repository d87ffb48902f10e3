"""Pictures of one camera under one light each: photometric stereo, RTI, light stages of another shape. Refused, with why."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.layouts.photographs import recognise as has_pictures
from pipeline.capture.light_stage.find_light_table import table_beside
from pipeline.capture.light_stage.folders import PASSES, pass_of, stage_folders
from pipeline.capture.model import Capture
from pipeline.errors import UserError

WAY = "docs/light_stage.md shows the folders: camNN/cross, camNN/parallel, cameras/cameraNN.txt, lights.csv"


def recognise(root: Path) -> bool:
    return table_beside(root) is not None and has_pictures(root)


def read(root: Path, config: CaptureConfig) -> Capture:
    """Refuse the capture. Raises UserError naming the light table and what the light stage lacks."""
    table = table_beside(root)
    assert table is not None
    raise UserError(table, f"a light table: these are pictures under one light each, no views; {_missing(root)}", WAY)


def _missing(root: Path) -> str:
    """What a light stage needs and is not here."""
    found = {which for camera in stage_folders(root).values() for which in camera.passes}
    loose = {which for p in root.rglob("*") if p.is_file() and not p.name.startswith(".") and (which := _pass_in(p.stem))}
    lacking = [f"{name} polarised frames (a {name}/ folder a camera)" for name in PASSES if name not in found | loose]
    if not lacking:
        lacking = ["a folder camNN/ with cross/ and parallel/ for each camera"]
    if not (root / "cameras").is_dir():
        lacking.append("a camera file (cameras/cameraNN.txt)")
    return f"a light stage needs {' and '.join(lacking)}"


def _pass_in(stem: str) -> str | None:
    return next((which for word in stem.replace("-", "_").split("_") if (which := pass_of(word))), None)


LAYOUT = Layout(
    "one_light_a_picture", "a light table (lights.csv, NAME.lp, light_directions.txt) beside pictures", recognise, read
)
