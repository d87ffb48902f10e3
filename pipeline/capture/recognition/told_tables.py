"""capture.toml against the capture: a table that matches nothing, or not everything, is an error that names what it missed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from pipeline.capture.config import MosaicConfig, OlatConfig, StackConfig
from pipeline.capture.model import Capture
from pipeline.capture.naming.files import some
from pipeline.errors import UserError


def refuse_idle_tables(capture: Capture) -> None:
    """Raise UserError where a table of capture.toml names views, files or kinds of files that this capture has not."""
    config = capture.config
    if config.path is None:
        return
    names = _names(capture)
    unknown = [key for key in config.radiometry.exposure_s if key not in names]
    if unknown:
        raise UserError(
            config.path, f"radiometry.exposure_s: no view or file is called {some(unknown)}", _nearest(unknown[0], names)
        )
    views = {v.view for v in capture.views}
    pair = [name for name in config.poses.scale_pair or () if name not in views]
    if pair:
        raise UserError(config.path, f"poses.scale_pair: there is no view {some(pair)}", _nearest(pair[0], views))
    if config.mosaic != MosaicConfig() and not _fact(capture, "polariser mosaic"):
        fault = f"[mosaic] is told, but the images were understood as {_kind(capture)}"
        raise UserError(config.path, fault, "give the sensor's single-channel files, or take the table out")
    if config.stack != StackConfig() and not _fact(capture, "stacks behind"):
        fault = f"[stack] is told, but the images were understood as {_kind(capture)}"
        raise UserError(config.path, fault, "name the angle of each file, or take the table out")
    if config.olat != OlatConfig() and capture.light_stage is None:
        fault = f"[olat] is told, but the capture was understood as {_kind(capture)}, no light stage"
        raise UserError(config.path, fault, "put the frames into camNN/cross and camNN/parallel, or take the table out")
    _refuse_idle_polarisers(capture)
    plate = config.clean_plate
    if plate is not None and not (capture.root / plate).exists():
        raise UserError(config.path, f"clean_plate: there is no {plate}", "give its path relative to the capture")
    if plate is not None and not capture.clean_plates and capture.views:
        fault = f"clean_plate: no picture in {plate} is named like a view or a camera"
        raise UserError(config.path, fault, "give one picture, or name them like the views or the cameras")


def _refuse_idle_polarisers(capture: Capture) -> None:
    cameras = set(capture.camera_names)
    unknown = sorted(set(capture.config.polarisers) - cameras)
    if unknown and capture.light_stage is None:
        fault = f"polarisers.{unknown[0]}: no camera has this name"
        raise UserError(capture.config.path or capture.root, fault, f"the cameras are {', '.join(sorted(cameras))}")


def _names(capture: Capture) -> set[str]:
    """Whatever a key may call a picture: VIEW, file stem, or its camera; a light stage's frames, passes and cameras."""
    out = {v.view for v in capture.views} | {p.stem for v in capture.views for p in v.paths}
    if capture.light_stage is not None:
        for camera in capture.light_stage.cameras.values():
            out |= {camera.name, "cross", "parallel", f"{camera.name}/cross", f"{camera.name}/parallel"}
            out |= {p.stem for p in (*camera.cross, *camera.parallel, *camera.full_light)}
    return out


def _nearest(name: str, names: Iterable[str]) -> str:
    """A remedy for a name that nothing has: the nearest ones, else the first few."""
    near = difflib.get_close_matches(name, sorted(names), 1)
    return f"did you mean {near[0]}?" if near else f"the names are {some(sorted(names))}"


def _fact(capture: Capture, begins: str) -> bool:
    return any(fact.startswith(begins) for fact in capture.facts)


def _kind(capture: Capture) -> str:
    return capture.layout.replace("_", " ")
