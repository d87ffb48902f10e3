"""Files that the parameters of the relight stage name: found, and refused before anything runs."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture import Capture
from pipeline.capture.named_file import named_file
from pipeline.capture.naming.safe_names import environment_name
from pipeline.errors import UserError

from .camera_path import read_camera_path
from .lights_file import read_lights
from .parameters import RelightParameters


def given_files(capture: Capture, parameters: RelightParameters) -> tuple[Path, ...]:
    """The files that the parameters name, each read once to see that it is right. Raises UserError."""
    cameras = named_file(capture, parameters.cameras, "relight.cameras")
    if cameras is not None:
        read_camera_path(cameras)
    lights = named_file(capture, parameters.lights, "relight.lights")
    if lights is not None:
        read_lights(lights)
        if environment_name(lights) in map(environment_name, capture.environments):
            raise UserError(lights, "has the same name as an environment map", "rename it: results are named after it")
    return tuple(path for path in (cameras, lights) if path is not None)
