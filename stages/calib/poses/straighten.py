"""Frames of cameras with lens distortion, written again as pinhole cameras would have taken them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.engine.stage import StageRun
from pipeline.formats.images import read_image, read_mask, read_stored, write_exr, write_mask, write_png
from pipeline.geometry.cameras import Camera, save_cameras
from pipeline.geometry.lens import FRAMES, LENSES, Straightener, bends, pinhole


def write_cameras(stage: StageRun, cameras: Mapping[str, Camera]) -> None:
    """Write cameras.json; where a lens bends, also frames/, frames.json and lenses.json (see pipeline.geometry.lens)."""
    bent = {view: camera for view, camera in sorted(cameras.items()) if bends(camera)}
    save_cameras(stage.output / "cameras.json", {view: pinhole(camera) for view, camera in cameras.items()})
    if not bent:
        return
    save_cameras(stage.output / LENSES, bent)
    decode = stage.inputs["decode"]
    table = json.loads((decode / FRAMES).read_text(encoding="utf-8"))
    with stage.progress.bar("undistorting", len(table["views"]), "views") as bar:

        def one(item: tuple[str, dict[str, Any]]) -> tuple[str, dict[str, Any]]:
            view, facts = item
            camera = bent.get(view)
            facts = _kept(facts, decode, stage.output) if camera is None else _straight(facts, camera, decode, stage.output)
            bar.advance()
            return view, facts

        with ThreadPoolExecutor(max(1, stage.jobs)) as pool:
            table["views"] = dict(pool.map(one, sorted(table["views"].items())))
    (stage.output / FRAMES).write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    stage.note("undistorted", len(bent))
    stage.progress.say(f"lens distortion: {len(bent)} frames are resampled to pinhole cameras (poses/frames)")


def _straight(facts: dict[str, Any], camera: Camera, decode: Path, output: Path) -> dict[str, Any]:
    """One view resampled; returns its facts. Pixels that the frame did not reach count as saturated: nothing is known."""
    lens = Straightener(camera.resized(facts["width"], facts["height"]))
    pixels, names, kind = read_stored(decode / facts["file"])
    straight = np.moveaxis(lens.image(pixels), -1, 0)
    write_exr(output / facts["file"], dict(zip(names, straight)), half=kind == "half")
    marks = lens.marks(read_mask(decode / facts["saturated"]) if facts["saturated"] else None)
    saturated = None
    if marks.any():
        saturated = f"saturated/{Path(facts['file']).stem}.png"
        write_mask(output / saturated, marks)
    if facts["alpha"]:
        write_png(output / facts["alpha"], lens.image(read_image(decode / facts["alpha"])[..., 0]))
    return {**facts, "saturated": saturated, "saturated_fraction": float(marks.mean())}


def _kept(facts: dict[str, Any], decode: Path, output: Path) -> dict[str, Any]:
    """A view whose lens does not bend, or that has no camera: its files as they are."""
    for name in (facts["file"], facts["saturated"], facts["alpha"]):
        if name:
            (output / name).parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(decode / name, output / name)
            except OSError:  # no links on this file system
                shutil.copyfile(decode / name, output / name)
    return facts
