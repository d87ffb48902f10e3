"""The dataset's cameras: pinholes in coordinates that its files can hold; frames of lenses that bend are written again."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import count, some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.dataset_files import CAMERAS
from pipeline.formats.given_mask import read_given
from pipeline.formats.images import read_image, read_mask, read_stored, write_exr, write_mask, write_png
from pipeline.geometry.cameras import Camera, save_cameras
from pipeline.geometry.lens import FRAMES, LENSES, Straightener, bends
from pipeline.geometry.straight_camera import UNREACHED, Straight, is_wide, object_rays, pinhole, straight_cameras, unreached
from pipeline.geometry.world_offset import less, offset_of

SENSOR_TURN_DEG = 2.0
"""Of a polariser's axis across an object, behind a fisheye: below it, less than the angle is known."""


def write_cameras(stage: StageRun, cameras: Mapping[str, Camera]) -> NDArray[np.float64]:
    """Write cameras.json; where a lens bends, also frames/, frames.json and lenses.json (see pipeline.geometry.lens).

    Returns the world offset [3] that was taken from all positions. Raises UserError on a lens that folds in its frame.
    """
    decode = stage.inputs["decode"]
    table = json.loads((decode / FRAMES).read_text(encoding="utf-8"))
    offset = offset_of(cameras)
    if offset.any():
        stage.note("world_offset", offset.tolist())
        stage.progress.say(f"large world coordinates: {', '.join(f'{x:g}' for x in offset)} is taken off in every file")
    cameras = {view: less(camera, offset) for view, camera in sorted(cameras.items())}
    bent = {v: _sized(c, table["views"].get(v)) for v, c in cameras.items() if bends(c)}
    _refuse_folds(stage, bent)
    objects = _objects(stage, bent, table["views"])
    straight = straight_cameras(bent, objects)
    _tell(stage, bent, straight, objects, table["views"])
    kept = {view: straight[view].camera if view in straight else pinhole(camera) for view, camera in cameras.items()}
    folder = "" if bent else f"../../{decode.parent.name}/{decode.name}/"
    files = {view: folder + table["views"][view]["file"] for view in kept if view in table["views"]}
    save_cameras(stage.output / CAMERAS, kept, files, offset)
    if bent:
        save_cameras(stage.output / LENSES, bent, files, offset)
        _write_frames(stage, table, {view: Straightener(bent[view], kept[view]) for view in bent})
    return offset


def _sized(camera: Camera, facts: Mapping[str, Any] | None) -> Camera:
    """The camera for the frame's size."""
    if facts is None or (camera.width, camera.height) == (facts["width"], facts["height"]):
        return camera
    return camera.resized(facts["width"], facts["height"])


def _refuse_folds(stage: StageRun, bent: Mapping[str, Camera]) -> None:
    """A model that folds within the frame puts two places of the scene into one pixel, and none into others."""
    checked: dict[tuple[Any, ...], float] = {}
    corners = []
    for view, c in bent.items():
        key = (c.lens, c.distortion, c.fx, c.fy, c.cx, c.cy, c.width, c.height)
        share = checked[key] if key in checked else checked.setdefault(key, unreached(c))
        if share > UNREACHED:
            fault = f"view {view}: its lens ({c.lens} {', '.join(f'{k:g}' for k in c.distortion)}) folds within the image"
            remedy = "check the coefficients and their order, or undistort the images first"
            raise UserError(stage.capture.camera_file, fault, remedy)
        if share > 0:
            corners.append(view)
    if corners:
        stage.warn(
            f"{stage.capture.camera_file}: the lens model folds in the corners of {count(corners, 'view')} ({some(corners)}), "
            "which are left out; check the coefficients"
        )


def _objects(stage: StageRun, bent: Mapping[str, Camera], views: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Rays of each view's object through a wide lens, where the capture has masks or alpha. Raises UserError on a sphere
    without them."""
    masks = stage.capture.masks
    out = {}
    for view, camera in bent.items():
        if not is_wide(camera):
            continue
        inside = read_given(masks[view]).inside if isinstance(masks, dict) and view in masks else None
        if masks == "alpha" and view in views and views[view]["alpha"]:
            inside = read_mask(stage.inputs["decode"] / views[view]["alpha"])
        if inside is not None:
            out[view] = object_rays(camera, inside)
        elif camera.lens == "EQUIRECTANGULAR":
            fault = f"view {view} is equirectangular: nothing tells where the object is"
            remedy = "add masks/, so that it can be looked at as a pinhole camera would, or cut perspective pictures out"
            raise UserError(stage.capture.camera_file, fault, remedy)
    return out


def _tell(
    stage: StageRun, bent: Mapping[str, Camera], straight: Mapping[str, Straight], objects: Mapping[str, NDArray[np.float64]],
    views: Mapping[str, Any],
) -> None:  # fmt: skip
    """What a user should know of wide lenses: an object that is cut, axes of polarisers that turn across the picture."""
    file = stage.capture.camera_file
    cut = [view for view in bent if not straight[view].whole]
    if cut:
        stage.warn(f"{file}: the pinhole pictures of {count(cut, 'view')} ({some(cut)}) may cut the object: check their masks")
    analysed = stage.capture.polarisation == "polarisers"
    wide = [v for v in bent if is_wide(bent[v]) and (analysed or (v in views and views[v]["design"] is not None))]
    worst = max((analyser_turn_deg(objects[v] if v in objects else _corner(straight[v].camera)) for v in wide), default=0.0)
    if worst > SENSOR_TURN_DEG:
        stage.warn(
            f"{file}: behind a fisheye a polariser's axes turn by up to {worst:.0f} degrees against those of the rays (the "
            "Stokes frame); AoLP there is off by as much: check it, and keep the object near the lens's axis"
        )


def _corner(camera: Camera) -> NDArray[np.float64]:
    """Rays [4, 3] to a pinhole picture's corners."""
    corners = np.array([(0, 0), (camera.width, 0), (0, camera.height), (camera.width, camera.height)], float)
    return camera.rays_at(corners)


def analyser_turn_deg(rays: NDArray[np.float64]) -> float:
    """Largest angle (degrees) at rays [N, 3] of the camera's frame between the axes that a lens carries to its sensor (those
    of the planes through its own axis stay) and those of `Camera.stokes_frame`.

    At the azimuth p, t off the axis, it is p - atan(cos t tan p), at most asin((1 - cos t) / (1 + cos t)): 1.4 degrees at
    t = 18, 7.2 at 39, 19.5 at 60.
    """
    across = np.hypot(rays[:, 0], rays[:, 1])
    cosine = rays[:, 2] / np.linalg.norm(rays, axis=-1)
    turn = np.arctan2(rays[:, 1], rays[:, 0]) - np.arctan2(cosine * rays[:, 1], rays[:, 0])
    turn = np.where(across > 0, np.mod(turn + np.pi / 2, np.pi) - np.pi / 2, 0)
    return float(np.degrees(np.abs(turn).max(initial=0.0)))


def _write_frames(stage: StageRun, table: dict[str, Any], lenses: Mapping[str, Straightener]) -> None:
    decode, total = stage.inputs["decode"], len(table["views"])
    with stage.progress.bar("undistorting", total, "views") as bar:

        def one(item: tuple[str, dict[str, Any]]) -> tuple[str, dict[str, Any]]:
            view, facts = item
            lens = lenses.get(view)
            facts = _kept(facts, decode, stage.output) if lens is None else _straight(facts, lens, decode, stage.output)
            bar.advance()
            return view, facts

        with ThreadPoolExecutor(max(1, stage.jobs)) as pool:
            table["views"] = dict(pool.map(one, sorted(table["views"].items())))
    (stage.output / FRAMES).write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    stage.note("undistorted", len(lenses))
    stage.progress.say(f"lens distortion: {len(lenses)} frames are resampled to pinhole cameras (poses/frames)")


def _straight(facts: dict[str, Any], lens: Straightener, decode: Path, output: Path) -> dict[str, Any]:
    """One view resampled; returns its facts. Pixels that the frame did not reach count as saturated: nothing is known."""
    pixels, names, kind = read_stored(decode / facts["file"])
    straight = np.moveaxis(lens.image(pixels, names), -1, 0)
    write_exr(output / facts["file"], dict(zip(names, straight)), half=kind == "half")
    marks = lens.marks(read_mask(decode / facts["saturated"]) if facts["saturated"] else None)
    saturated = None
    if marks.any():
        saturated = f"saturated/{Path(facts['file']).stem}.png"
        write_mask(output / saturated, marks)
    if facts["alpha"]:
        write_png(output / facts["alpha"], lens.image(read_image(decode / facts["alpha"])[..., 0]))
    height, width = marks.shape
    return {**facts, "width": width, "height": height, "saturated": saturated, "saturated_fraction": float(marks.mean())}


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
