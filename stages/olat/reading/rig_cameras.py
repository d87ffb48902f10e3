"""What is to be fitted: each camera's frames in the order of the lights, its pose, its mask, and the bands they are read in."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.model import Passes
from pipeline.capture.naming.files import some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.images import read_mask
from pipeline.geometry.cameras import Camera, camera_from_frame
from pipeline.rig.frame_files import frames_root
from pipeline.rig.light_table import LightTable
from pipeline.rig.solid_angles import solid_angles
from stages.olat.parameters import OlatParameters, every
from stages.olat.reading.frame_reader import is_half
from stages.olat.reading.scanline_bands import Band, bands_of

PILOT = 150  # pixels on which the lobe is chosen: its share of them is known to 4 percent points


@dataclass(frozen=True)
class CameraJob:
    """One camera's frames in the order of the lights, its pose, its mask and its bands; half: the frames are half floats;
    passes: which it has (of one alone both lists are the same)."""

    name: str
    cross: list[Path]
    parallel: list[Path]
    camera: Camera
    mask: NDArray[np.bool_]
    half: bool
    bands: list[Band]
    passes: Passes = "both"


def decoded(stage: StageRun) -> dict[str, Any]:
    """The index of the light stage that decode left."""
    return json.loads((stage.inputs["decode"] / "olat.json").read_text())


def light_rig(index: dict[str, Any], step: int = 1) -> LightTable:
    """The lights of olat.json, each `step`-th, with solid angles (computed where the table has none)."""
    table = index["lights"]
    directions = np.array(table["directions"])[::step]
    positions = np.array(table["positions"])[::step]
    intensity = np.array(table["intensity"])[::step]
    given = table.get("solid_angle")
    area = np.array(given) if given is not None and step == 1 else solid_angles(directions)
    colour = np.array(table["colour"])[::step] if "colour" in table else None
    return LightTable(directions, positions, intensity, area, colour=colour)


def camera_jobs(stage: StageRun) -> list[CameraJob]:
    """Every camera that sees the object, with its mask (masks stage, else the capture's, else the whole frame).

    Raises UserError where none does, or masks and frames differ in size.
    """
    index = decoded(stage)
    frames = frames_root(index, stage.capture.root, stage.inputs["decode"])
    found = {name: _job(stage, name, entry, frames) for name, entry in index["cameras"].items()}
    jobs = [job for job in found.values() if job is not None]
    blind = [name for name, job in found.items() if job is None]
    if not jobs:
        raise UserError(stage.capture.root, "no camera's mask shows an object", "mend the masks")
    if blind:
        stage.warn(
            f"{stage.capture.root}: no object in the mask of {some(blind)}: left out; check the mask if it should be seen"
        )
    return jobs


def _job(stage: StageRun, name: str, entry: dict[str, Any], frames: Path) -> CameraJob | None:
    root = stage.capture.root
    parameters: OlatParameters = stage.parameters
    camera = camera_from_frame({"file_path": name, **entry["camera"]}, {}, stage.inputs["decode"] / "olat.json")
    made = stage.inputs["masks"] / f"{name}.png" if "masks" in stage.inputs else None
    path = made if made is not None and made.is_file() else (root / entry["mask"] if entry.get("mask") else None)
    shape = (int(entry["height"]), int(entry["width"]))
    mask = read_mask(path) if path is not None else np.ones(shape, bool)
    if mask.shape != shape:
        raise UserError(
            path or root, f"is {mask.shape[1]}x{mask.shape[0]}, the frames {shape[1]}x{shape[0]}", "make it their size"
        )
    if not mask.any():
        return None
    step = every(parameters.lights)
    cross, parallel = ([frames / p for p in entry[key]][::step] for key in ("cross", "parallel"))
    half = all(is_half(path) for path in (cross[0], parallel[0]))
    bands = bands_of(mask, len(cross), parameters.band_mb, 2 if half else 4)
    return CameraJob(name, cross, parallel, camera, mask, half, bands, entry.get("passes", "both"))


def middle_chunk(job: CameraJob) -> Band:
    """The chunk of scanlines in the middle of the object, thinned: little to read, and where highlights are."""
    chunks = bands_of(job.mask, len(job.cross), 0.0, 2)
    chunk = chunks[len(chunks) // 2]
    return replace(chunk, pixels=chunk.pixels[:: max(1, len(chunk.pixels) // PILOT)])
