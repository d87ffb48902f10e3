"""SMVP3D: s0/ s1/ s2/ with NNNN.npy (twice the radiance), mask/, cameras.npz."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.capture.assembly.assemble import assemble
from pipeline.capture.assembly.camera_source import from_idr
from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.layouts.array_files import array_size, load_array
from pipeline.capture.model import Capture, DecodedView, ViewSource
from pipeline.capture.pixels.stokes_files import finished
from pipeline.capture.pixels.stokes_frame import FROM_SUMS, FROM_SUMS_FACT, apply_stokes_config
from pipeline.errors import UserError

FOLDERS, CAMERAS = ("s0", "s1", "s2"), "cameras.npz"


def recognise(root: Path) -> bool:
    return all((root / f).is_dir() and any((root / f).glob("[!.]*.npy")) for f in FOLDERS)


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture. Raises UserError naming a missing part."""
    views = []
    for path in sorted((root / "s0").glob("[!.]*.npy")):
        paths = tuple(root / f / path.name for f in FOLDERS)
        missing = [p for p in paths if not p.is_file()]
        if missing:
            raise UserError(missing[0], "is missing", "every view needs s0, s1 and s2")
        views.append(ViewSource(path.stem, paths, "camera", _loader(paths, config), array_size(path)))
    sizes = {v.view: v.size or (0, 0) for v in views}
    has_cameras = (root / CAMERAS).is_file()
    cameras = from_idr(root / CAMERAS, list(sizes), sizes) if has_cameras else None
    capture = assemble(
        root, "smvp3d", config, root / "s0", tuple(views), "stokes", cameras, (root / CAMERAS,) if has_cameras else ()
    )
    return replace(capture, facts=(FROM_SUMS_FACT,))


def _loader(paths: tuple[Path, ...], config: CaptureConfig) -> Callable[[], DecodedView]:
    def load() -> DecodedView:
        parts = [load_array(p) for p in paths]
        for path, part in zip(paths, parts):
            if part.shape != parts[0].shape:
                raise UserError(
                    path,
                    f"is {part.shape[1]}x{part.shape[0]}, its s0 {parts[0].shape[1]}x{parts[0].shape[0]}",
                    "one size a view",
                )
        stokes = np.stack(parts, axis=2) * FROM_SUMS
        return finished(DecodedView(stokes=apply_stokes_config(stokes, config.stokes)), paths[0])

    return load


LAYOUT = Layout("smvp3d", "s0/NNNN.npy, s1/NNNN.npy, s2/NNNN.npy and cameras.npz", recognise, read)
