"""Files that the parameters of the relight stage name: found, and refused before anything runs."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture import Capture
from pipeline.capture.naming.safe_names import environment_name
from pipeline.errors import UserError

from .camera_path import read_camera_path
from .lights_file import read_lights
from .parameters import RelightParameters


def given_file(capture: Capture, name: str, key: str) -> Path | None:
    """The file called `name`: in the capture's folder, else where the command runs; None where none is given.

    key: the parameter that names it. Raises UserError.
    """
    if not name:
        return None
    for path in (capture.root / name, Path(name)):
        if path.is_file():
            return path
    raise UserError(name, "no such file, in the capture's folder or here", f"check {key}=")


def given_files(capture: Capture, parameters: RelightParameters) -> tuple[Path, ...]:
    """The files that the parameters name, each read once to see that it is right. Raises UserError."""
    cameras = given_file(capture, parameters.cameras, "relight.cameras")
    if cameras is not None:
        read_camera_path(cameras)
    lights = given_file(capture, parameters.lights, "relight.lights")
    if lights is not None:
        read_lights(lights)
        if environment_name(lights) in map(environment_name, capture.environments):
            raise UserError(lights, "has the same name as an environment map", "rename it: results are named after it")
    return tuple(path for path in (cameras, lights) if path is not None)
