"""What segmentation reads of earlier stages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.formats.dataset_files import CAMERAS, frame
from pipeline.formats.images import RGB, S0, read_image
from pipeline.geometry.cameras import Camera, load_cameras
from pipeline.geometry.lens import frames_folder


def frame_s0(stage: StageRun, view: str) -> NDArray[np.float32]:
    """A decoded frame's radiance [H, W, 3]: s0, or the plain colour."""
    path = frame(frames_folder(stage.inputs), view)
    stokes = stage.capture.polarisation == "stokes"
    return np.maximum(read_image(path, S0 if stokes else RGB), 0)


def cameras_of(stage: StageRun) -> dict[str, Camera]:
    """The poses stage's cameras by VIEW; empty without any."""
    if "poses" not in stage.inputs or not (stage.inputs["poses"] / CAMERAS).is_file():
        return {}
    return load_cameras(stage.inputs["poses"] / CAMERAS)
