"""capture.toml against the capture: a table that matches nothing, or not everything, is an error that names what it missed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import fields

from pipeline.capture.config import MosaicConfig, OlatConfig, RadiometryConfig, RawConfig, StackConfig, StokesConfig
from pipeline.capture.model import Capture
from pipeline.capture.naming.files import some
from pipeline.capture.radiometry.exposure import known_seconds
from pipeline.errors import UserError
from pipeline.geometry.camera_check import SHORTEST_FOCAL

SAME_ANGLE_DEG = 5.0
"""Between polarisers: less tells hardly any polarisation."""
ARRAYS = frozenset({"rmvp3d", "smvp3d"})
"""Layouts of NumPy files that hold Stokes vectors in radiance."""


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
        raise UserError(config.path, f"poses.scale_pair: no view is called {some(map(repr, pair))}", _nearest(pair[0], views))
    longest = max((max(v.size) for v in capture.views if v.size is not None), default=0)
    if config.poses.focal_px is not None and config.poses.focal_px < SHORTEST_FOCAL * longest:
        fault = f"poses.focal_px = {config.poses.focal_px:g} is no focal length of pictures of {longest} pixels"
        raise UserError(config.path, fault, "give it in pixels: millimetres x pixels / millimetres of the sensor's width")
    if config.mosaic != MosaicConfig() and not _fact(capture, "polariser mosaic"):
        fault = f"[mosaic] is set, but the images were understood as {_kind(capture)}"
        raise UserError(config.path, fault, "give the sensor's single-channel files, or take the table out")
    if config.stokes != StokesConfig() and capture.polarisation != "stokes":
        fault = f"[stokes] is set, but the images were understood as {_kind(capture)}, without Stokes vectors"
        raise UserError(config.path, fault, "take the table out, or give images that hold them")
    if config.stack != StackConfig() and not _fact(capture, "stacks behind"):
        fault = f"[stack] is set, but the images were understood as {_kind(capture)}"
        raise UserError(config.path, fault, "name the angle of each file, or take the table out")
    if config.raw != RawConfig() and not any(p.suffix.lower() == ".raw" for v in capture.views for p in v.paths):
        raise UserError(config.path, "[raw] is set, but no image is a .raw file of bare samples", "take the table out")
    if config.olat != OlatConfig() and capture.light_stage is None:
        fault = f"[olat] is set, but the capture was understood as {_kind(capture)}, no light stage"
        raise UserError(config.path, fault, "put the frames into camNN/cross and camNN/parallel, or take the table out")
    _refuse_idle_polarisers(capture)
    _refuse_idle_radiometry(capture)
    plate = config.clean_plate
    if plate is not None and not (capture.root / plate).exists():
        raise UserError(config.path, f"clean_plate: there is no {plate}", "give its path relative to the capture")
    if plate is not None and not capture.clean_plates and capture.views:
        fault = f"clean_plate: no picture in {plate} is named like a view or a camera"
        raise UserError(config.path, fault, "give one picture, or name them like the views or the cameras")


def polarisers_alike(capture: Capture) -> list[str]:
    """A line where every camera's polariser is known to stand at one angle, so that no polarisation can be told."""
    known = [p.angle_deg for p in capture.polarisers.values() if p.trusted and p.angle_deg is not None]
    if capture.polarisation != "polarisers" or not 2 <= len(known) == len(capture.polarisers):
        return []
    if max(abs((angle - known[0] + 90) % 180 - 90) for angle in known) > SAME_ANGLE_DEG:
        return []
    fault = f"the polarisers of {some(sorted(capture.polarisers))} all stand at {known[0] % 180:g} degrees"
    return [f"{capture.config.path}: {fault}: nothing tells polarisation then; check the angles, or say trusted = false"]


def exposures_for_some(capture: Capture) -> list[str]:
    """A line where exposure_s tells some of a capture's views, and the others are taken as they are beside them."""
    known = capture.config.radiometry.exposure_s
    single = [v for v in capture.views if len(v.paths) == 1]
    silent = [v.view for v in single if known_seconds(v.paths[0], v.view, known) is None]
    if not known or not silent or len(silent) == len(single):
        return []
    fault = f"radiometry.exposure_s tells {len(single) - len(silent)} of {len(single)} views (not {some(silent)})"
    return [f"{capture.config.path}: {fault}: the others are taken as if exposed for 1 s; give each its exposure"]


def _refuse_idle_polarisers(capture: Capture) -> None:
    cameras = set(capture.camera_names)
    unknown = sorted(set(capture.config.polarisers) - cameras)
    if unknown and capture.light_stage is None:
        fault = f"polarisers.{unknown[0]}: no camera has this name"
        raise UserError(capture.config.path or capture.root, fault, f"the cameras are {', '.join(sorted(cameras))}")


def _refuse_idle_radiometry(capture: Capture) -> None:
    """Raise UserError where capture.toml names a dark frame or flat field that is not there, or that nothing would use."""
    radiometry = capture.config.radiometry
    toml = capture.config.path or capture.root / "capture.toml"
    if capture.layout in ARRAYS and radiometry != RadiometryConfig():
        idle = [f.name for f in fields(radiometry) if getattr(radiometry, f.name) != getattr(RadiometryConfig(), f.name)]
        raise UserError(toml, f"radiometry.{idle[0]} is not used: {capture.layout} files hold Stokes vectors", "take it out")
    below = {p.parent for view in capture.views for p in view.paths} | {capture.root}
    folders = {f for folder in below for f in (folder, *folder.parents) if f.is_relative_to(capture.root)}
    for key in ("dark_frame", "flat_field"):
        name = getattr(radiometry, key)
        if name is not None and not any((folder / name).is_file() for folder in folders):
            raise UserError(toml, f"radiometry.{key} = {name!r} is not there", "give its path relative to the capture")


def _names(capture: Capture) -> set[str]:
    """Whatever a key may call a picture: VIEW, file stem, or its camera; a light stage's frames, passes and cameras."""
    out = {v.view for v in capture.views} | {name for v in capture.views for p in v.paths for name in (p.stem, p.name)}
    if capture.light_stage is not None:
        for camera in capture.light_stage.cameras.values():
            out |= {camera.name, "cross", "parallel", f"{camera.name}/cross", f"{camera.name}/parallel"}
            for which, frames in (("cross", camera.cross), ("parallel", camera.parallel)):
                named = {f"{camera.name}/{which}/{p.stem}" for p in frames}
                out |= named | {n.replace("/", "_") for n in named} | {n for p in frames for n in (p.stem, p.name)}
    return out


def _nearest(name: str, names: Iterable[str]) -> str:
    """A remedy for a name that nothing has: the nearest ones, else the first few."""
    near = difflib.get_close_matches(name, sorted(names), 1)
    return f"did you mean {near[0]}?" if near else f"the names are {some(sorted(names))}"


def _fact(capture: Capture, begins: str) -> bool:
    return any(fact.startswith(begins) for fact in capture.facts)


def _kind(capture: Capture) -> str:
    return capture.layout.replace("_", " ")
