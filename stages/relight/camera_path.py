"""A file of cameras to relight from: nerfstudio's `transforms.json`, our own cameras.json, or nerfstudio's camera paths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.json_file import read_json
from pipeline.geometry.cameras import Camera, camera_from_frame
from pipeline.geometry.world_offset import less

REMEDY = 'give it "frames" as transforms.json has them, or "camera_path" as nerfstudio exports it'
FRAMES_PER_SECOND = 24.0
MOST_PIXELS = 1 << 26  # of a frame, whose rays are held in memory


@dataclass(frozen=True)
class CameraPath:
    """Cameras in the order of the file, and how fast they are shown."""

    cameras: list[Camera]
    frames_per_second: float = FRAMES_PER_SECOND


def read_camera_path(path: Path) -> CameraPath:
    """The cameras of a file, in the capture's world (its "world_offset" added). Raises UserError."""
    table = read_json(path)
    if not isinstance(table, dict):
        raise UserError(path, "is no table of cameras", REMEDY)
    frames: Any = _nerfstudio_path(table, path) if isinstance(table.get("camera_path"), list) else table.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(f, dict) for f in frames):
        raise UserError(path, "holds no cameras", REMEDY)
    offset = _offset(table, path)
    cameras = [less(camera_from_frame(frame, table, path), -offset) for frame in frames]
    for k, camera in enumerate(cameras):
        if not camera.is_pinhole:
            raise UserError(path, f"frame {k} has a lens that bends lines", "give a pinhole: relit images have none")
        if camera.width * camera.height > MOST_PIXELS:
            raise UserError(path, f"frame {k} has {camera.width}x{camera.height} pixels", f"{MOST_PIXELS} are allowed")
    rate = table.get("fps", FRAMES_PER_SECOND)
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0.1 <= rate <= 240:
        raise UserError(path, f"fps = {rate!r} is not a number from 0.1 to 240", "correct it")
    return CameraPath(cameras, float(rate))


def in_world(path: CameraPath, offset: NDArray[np.float64]) -> CameraPath:
    """The path in a world whose origin lies at `offset` [3] of the capture's."""
    return CameraPath([less(camera, offset) for camera in path.cameras], path.frames_per_second)


def _offset(table: Mapping[str, Any], path: Path) -> NDArray[np.float64]:
    try:
        offset = np.asarray(table.get("world_offset", (0.0, 0.0, 0.0)), float)
    except (TypeError, ValueError):
        offset = np.zeros(0)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise UserError(path, "world_offset is no point", "give three numbers, or leave it out")
    return offset


def _nerfstudio_path(table: Mapping[str, Any], path: Path) -> list[dict[str, Any]]:
    """Frames as `camera_from_frame` takes them: fov is vertical, in degrees, and the size is the file's for all."""
    height, width = table.get("render_height"), table.get("render_width")
    out = []
    for k, frame in enumerate(table["camera_path"]):
        entry = frame if isinstance(frame, dict) else {}
        try:
            matrix = np.asarray(entry.get("camera_to_world"), float).reshape(4, 4)
            angle = np.radians(float(entry["fov"]))
        except (TypeError, ValueError, KeyError):
            raise UserError(path, f"frame {k} has no camera_to_world of 16 numbers or no fov", "export it again") from None
        if not 0 < angle < np.pi:
            raise UserError(path, f"frame {k}: fov = {entry['fov']!r} is not between 0 and 180 degrees", "correct it")
        size = {key: value for key, value in (("w", width), ("h", height)) if value is not None}
        out.append({"file_path": f"{k}", "transform_matrix": matrix.tolist(), "camera_angle_y": angle, **size})
    return out
