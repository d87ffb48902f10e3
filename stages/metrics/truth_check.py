"""Is a capture's ground truth what it should be? Asked before any stage runs: metrics, the last, is the first to use it."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pipeline.capture import Capture
from pipeline.capture.light_stage.folders import home_of
from pipeline.errors import UserError
from pipeline.formats.arrays import array_names, array_shape
from pipeline.formats.images import channel_names, image_size, read_image
from pipeline.formats.json_file import read_json

from .material_figures import CHANNELS as MATERIAL
from .mesh_figures import read_mesh

MEND = "mend or remove it"
CHANNELS = {"normal": ("X", "Y", "Z"), "relight": ("S0.R", "S0.G", "S0.B"), "material": MATERIAL}
"""Of the images in gt/FOLDER that are compared with."""
MAPS = {"mask": (), "normal": (3,), "albedo": (3, 4), "dp_du": (3, 4), "specular_albedo": (), "sigma": (2,), "occlusion": ()}
"""Arrays of maps.npz: [H, W] or [H, W, this many]; the first three have to be there."""
NEEDED = ("mask", "normal", "albedo")
READ_S = 15.0
"""Seconds of reading pixels, to find files that end early; after that headers must do."""


def check_truth(capture: Capture, files: Iterable[Path]) -> None:
    """Raise UserError naming the first of the ground truth's files that metrics could not use."""
    root, truth = capture.root, capture.truth
    sizes = {v.view: v.size for v in capture.views}
    started = time.monotonic()
    for path in files:
        parts = path.relative_to(root).parts
        if path.name == "maps.npz":
            _check_maps(path, capture)
        elif path.suffix == ".json":
            _check_document(path)
        elif path == truth.mesh:
            read_mesh(path)
        elif parts == ("gt", "env.hdr") or (parts[1] in CHANNELS and path.suffix == ".exr"):
            size = sizes.get(truth.view_of(path.stem) or "")
            _check_image(path, parts[1], size, time.monotonic() - started < READ_S)


def _check_image(path: Path, kind: str, size: tuple[int, int] | None, whole: bool) -> None:
    channels = CHANNELS.get(kind, ("R", "G", "B"))
    have = {name.lower() for name in channel_names(path)}
    missing = [c for c in channels if c.lower() not in have]
    if missing:
        raise UserError(path, f"has no channel {', '.join(missing)}", MEND)
    if kind in ("relight", "material") and size is not None and image_size(path) != size:
        have_size, want = (f"{w}x{h}" for w, h in (image_size(path), size))
        raise UserError(path, f"is {have_size}, its view {want}", "render it in the view's size, or remove it")
    if whole:
        read_image(path, channels)


def _check_maps(path: Path, capture: Capture) -> None:
    names, shapes = array_names(path), {}
    for name, depth in MAPS.items():
        if name not in names:
            if name not in NEEDED:
                continue
            raise UserError(path, f"has no {name} (it has {', '.join(names[:8])})", "add it, or remove the file")
        shape = array_shape(path, name)
        shapes[name] = shape[:2]
        if len(shape) != 2 + bool(depth) or (depth and shape[2] not in depth):
            wanted = ", ".join(map(str, ("height", "width", *depth[:1])))
            raise UserError(path, f"its {name} has the shape {shape}, not ({wanted})", MEND)
    for camera in capture.light_stage.cameras.values() if capture.light_stage else ():
        if home_of(capture.root, camera.name) != path.parents[1]:
            continue
        want = (camera.camera.height, camera.camera.width)
        for name, have in shapes.items():
            if have != want:
                raise UserError(
                    path, f"its {name} is {have[1]}x{have[0]}, the frames {want[1]}x{want[0]}", "make it their size"
                )


def _check_document(path: Path) -> None:
    wanted = {"gt_brdf.json", "gt_lp.json", "polarisers.json", "material.json"}
    if path.name not in wanted:
        return
    table = read_json(path, MEND)
    if not isinstance(table, dict):
        raise UserError(path, "holds no table of names and values", MEND)
    if path.name == "gt_brdf.json":
        sigma = table.get("sigma")
        if not isinstance(sigma, list) or len(sigma) != 2 or not all(_positive(s) for s in sigma):
            raise UserError(path, "its sigma is not two numbers above 0", MEND)
    elif path.name == "gt_lp.json":
        angles = table.get("true_angles_deg")
        if not isinstance(angles, list) or not all(_number(a) for a in angles):
            raise UserError(path, "its true_angles_deg is not a list of numbers", MEND)
    elif path.name == "polarisers.json":
        if wrong := next((k for k, v in table.items() if not _number(v)), None):
            raise UserError(path, f"the angle of {wrong} is not a number", MEND)
    elif wrong := next((k for k in ("ior", "alpha") if table.get(k) is not None and not _positive(table[k])), None):
        raise UserError(path, f"{wrong} is not a number above 0", MEND)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _positive(value: Any) -> bool:
    return _number(value) and value > 0
