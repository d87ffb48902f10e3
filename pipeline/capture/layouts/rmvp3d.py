"""RMVP3D: images_stokes/NNNN.npz with S0, S1, S2 (twice the radiance), mask/NNNN.png, cameras.npz."""

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

FOLDER, CAMERAS = "images_stokes", "cameras.npz"
PARTS = ("S0", "S1", "S2")


def recognise(root: Path) -> bool:
    return (root / FOLDER).is_dir() and any((root / FOLDER).glob("[!.]*.npz"))


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture. Raises UserError."""
    folder = root / FOLDER
    paths = sorted(folder.glob("[!.]*.npz"))
    views = tuple(ViewSource(p.stem, (p,), "camera", _loader(p, config), array_size(p, "S0")) for p in paths)
    sizes = {v.view: v.size or (0, 0) for v in views}
    has_cameras = (root / CAMERAS).is_file()
    cameras = from_idr(root / CAMERAS, list(sizes), sizes) if has_cameras else None
    capture = assemble(root, "rmvp3d", config, folder, views, "stokes", cameras, (root / CAMERAS,) if has_cameras else ())
    return replace(capture, facts=(FROM_SUMS_FACT,))


def _loader(path: Path, config: CaptureConfig) -> Callable[[], DecodedView]:
    def load() -> DecodedView:
        parts = [load_array(path, key) for key in PARTS]
        if len({p.shape for p in parts}) > 1:
            raise UserError(path, f"S0, S1, S2 have the shapes {[p.shape for p in parts]}", "export them alike")
        stokes = np.stack(parts, axis=2) * FROM_SUMS
        return finished(DecodedView(stokes=apply_stokes_config(stokes, config.stokes)), path)

    return load


LAYOUT = Layout("rmvp3d", "images_stokes/NNNN.npz (S0, S1, S2) and cameras.npz", recognise, read)
