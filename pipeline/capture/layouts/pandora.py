"""PANDORA: images_stokes/NAME_s0.hdr, _s0p1.hdr, _s0p2.hdr (twice the radiance), masks/, cameras.npz."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.capture.assembly.assemble import assemble
from pipeline.capture.assembly.camera_source import from_idr
from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture, DecodedView, ViewSource
from pipeline.capture.naming.files import FLOAT_SUFFIXES
from pipeline.capture.naming.grouping import Exposure
from pipeline.capture.pixels.brackets import read_exposures
from pipeline.capture.pixels.linear_image import balance
from pipeline.capture.pixels.stokes_files import finished
from pipeline.capture.pixels.stokes_frame import FROM_SUMS, FROM_SUMS_FACT, apply_stokes_config
from pipeline.errors import UserError
from pipeline.formats.images import image_size

FOLDER, CAMERAS = "images_stokes", "cameras.npz"
PARTS = ("s0", "s0p1", "s0p2")


def recognise(root: Path) -> bool:
    folder = root / FOLDER
    return folder.is_dir() and any(p.suffix.lower() in FLOAT_SUFFIXES for p in folder.glob("[!.]*_s0.*"))


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture. Raises UserError naming a missing part."""
    folder = root / FOLDER
    found: dict[str, dict[str, Path]] = {}
    for path in sorted(folder.iterdir()):
        name, _, part = path.stem.rpartition("_")
        if path.suffix.lower() in FLOAT_SUFFIXES and part in PARTS and not path.name.startswith("."):
            found.setdefault(name, {})[part] = path
    views = []
    for name, parts in sorted(found.items()):
        missing = [p for p in PARTS if p not in parts]
        if missing:
            raise UserError(folder / f"{name}_{missing[0]}.hdr", "is missing", "every view needs _s0, _s0p1 and _s0p2")
        paths = tuple(parts[p] for p in PARTS)
        views.append(ViewSource(name, paths, "camera", _loader(name, paths, config), image_size(paths[0])))
    sizes = {v.view: v.size or (0, 0) for v in views}
    has_cameras = (root / CAMERAS).is_file()
    cameras = from_idr(root / CAMERAS, list(sizes), sizes) if has_cameras else None
    capture = assemble(
        root, "pandora", config, folder, tuple(views), "stokes", cameras, (root / CAMERAS,) if has_cameras else ()
    )
    return replace(capture, facts=(FROM_SUMS_FACT,))


def _loader(name: str, paths: tuple[Path, ...], config: CaptureConfig) -> Callable[[], DecodedView]:
    def load() -> DecodedView:
        radiometry = replace(config.radiometry, encoding="linear")
        images = [read_exposures([Exposure(p)], radiometry, view=name) for p in paths]
        parts = [image.rgb(p) for image, p in zip(images, paths)]
        if len({p.shape for p in parts}) > 1:
            raise UserError(paths[1], f"is {parts[1].shape[:2]}, {paths[0].name} is {parts[0].shape[:2]}", "one size a view")
        s0, s0p1, s0p2 = parts
        stokes = np.stack([s0, s0p1 - s0, s0p2 - s0], axis=2) * FROM_SUMS
        balance(stokes, radiometry)
        lost = np.logical_or.reduce([image.saturated for image in images])
        view = DecodedView(stokes=apply_stokes_config(stokes, config.stokes), saturated=lost)
        return finished(view, paths[0], images[0])

    return load


LAYOUT = Layout("pandora", "images_stokes/NAME_s0.hdr, NAME_s0p1.hdr, NAME_s0p2.hdr and cameras.npz", recognise, read)
