"""Cameras of a light stage that has no camera files: from transforms.json, a COLMAP model or another program's table.

Such files name a picture of each camera: one of its frames, or one of a calibration. What tells the camera is its number in the
picture's path (cam03/all.png, images/camera_3.png, cam03_0001.jpg).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from pipeline.capture.assembly.camera_source import camera_table
from pipeline.capture.camera_files.transforms_json import load_frames, table_files
from pipeline.capture.light_stage.folders import camera_number
from pipeline.errors import UserError
from pipeline.geometry.cameras import Camera, camera_from_frame

Size = tuple[int, int]
NAMES = "name a picture of each camera as its folder is named (cam03/..., camera_3.png)"


@dataclass(frozen=True)
class GivenCameras:
    """Cameras by the names of their pictures, from `path`; camera(i, size): entry i for frames of (width, height)."""

    path: Path
    files: tuple[Path, ...]
    names: tuple[str, ...]
    camera: Callable[[int, Size], Camera]

    def of(self, name: str, size: Size, alone: bool) -> Camera:
        """The camera `name` ("camNN") for frames of this size; `alone`: the stage has no other. Raises UserError."""
        number = camera_number(name)
        found = [k for k, picture in enumerate(self.names) if number in numbers_in(picture)]
        if not found and alone and len(self.names) == 1:
            found = [0]
        if not found:
            raise UserError(self.path, f"names no picture of {name} (first: {self.names[0]})", NAMES)
        camera = self.camera(found[0], size)
        if abs(camera.width * size[1] - camera.height * size[0]) > max(camera.width, camera.height):
            fault = (
                f"says {camera.width}x{camera.height} of {self.names[found[0]]}, the frames of {name} are {size[0]}x{size[1]}"
            )
            raise UserError(self.path, fault, "give cameras of the frames' shape, unrotated")
        return replace(camera.resized(*size) if (camera.width, camera.height) != size else camera, name=name)


def given_cameras(root: Path) -> GivenCameras | None:
    """The cameras that lie beside a light stage; None where there are none. Raises UserError on damaged ones."""
    if tables := table_files(root):
        frames = load_frames(tables)

        def of_frame(index: int, size: Size) -> Camera:
            frame = frames[index]
            own = {} if "w" in {**frame.table, **frame.entry} else {"w": size[0], "h": size[1]}
            return camera_from_frame({**frame.entry, **own}, frame.table, frame.where)

        return GivenCameras(tables[0], tuple(tables), tuple(f.entry["file_path"] for f in frames), of_frame) if frames else None
    table, _ = camera_table(root, root)
    if table is None or not table.names:
        return None
    return GivenCameras(table.path, table.files or (table.path,), table.names, table.checked)


def cameras_of_views(views: Mapping[str, Camera], path: Path) -> GivenCameras:
    """The cameras of a capture's views for a light stage in the same world.

    Args:
        views: by VIEW, which tells the camera as the name of a picture does.
        path: what they were read from, for errors.

    Returns:
        The same as of a file beside the light stage.
    """
    cameras = tuple(views.values())
    return GivenCameras(path, (), tuple(views), lambda index, size: cameras[index])


def numbers_in(picture: str) -> set[int]:
    """Every number of a camera that a picture's path tells, in its folders or at the beginning of its name."""
    *folders, name = PurePosixPath(picture.replace("\\", "/")).parts
    stem = PurePosixPath(name).stem
    words = [*folders, stem, *re.split(r"[_\-. ]", stem)[:1]]
    return {number for word in words if (number := camera_number(word)) is not None}
