"""Pictures of one camera under one light each, without polarisers: photometric stereo, RTI domes, DiLiGenT's folders.

A table without cameras tells directions as its camera sees them: x to the right, y up, z towards the camera, far away.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pipeline.capture.assembly.sources import size_of
from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.layouts.ict_light_stage import read_camera
from pipeline.capture.layouts.photographs import recognise as has_pictures
from pipeline.capture.light_stage.folders import PASSES, camera_file, pass_of
from pipeline.capture.light_stage.frame_numbers import numbered
from pipeline.capture.light_stage.frames import PassFrames, frame_offset, frames_by_name, left_out_fact, one_pass_facts
from pipeline.capture.light_stage.read_light_table import read_light_table, table_beside
from pipeline.capture.model import Capture, LightStage, LightStageCamera
from pipeline.capture.naming.files import IMAGE_SUFFIXES, find_environments, image_folder, list_images, some
from pipeline.errors import UserError
from pipeline.formats.images import image_size
from pipeline.geometry.cameras import Camera, camera_from_opengl
from pipeline.rig.light_table import LightTable

WAY = "docs/light_stage.md shows the folders: camNN/cross, camNN/parallel, cameras/cameraNN.txt, lights.csv"
CAMERA = "cam00"
FAR = 1000.0  # of half the frame's width: rays then differ by 0.06 degrees from one side to the other
MASK = re.compile(r"(?:^|[_\-. ])(?:mask|matte|silhouette)s?\d*$", re.IGNORECASE)
NO_LIGHT = re.compile(
    r"(?:^|[_\-. ])(?:mask|matte|silhouette|normal|depth|albedo|gt|truth|ambient|background|average|mean|preview)s?"
    r"(?:$|[_\-. ])",
    re.IGNORECASE,
)
"""Names of pictures beside the frames that show no single light."""


def recognise(root: Path) -> bool:
    return table_beside(root) is not None and has_pictures(root)


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open pictures and their light table as a light stage of one camera and one pass. Raises UserError."""
    beside = table_beside(root)
    assert beside is not None
    lights, tables = read_light_table(root, config)
    folder = beside.parent if list_pictures(beside.parent) else image_folder(root)
    pictures = list_pictures(folder)
    _refuse_passes(beside, pictures)
    frames = frames_of(pictures, lights, folder, tables[-1], config.olat.first_frame)
    size = size_of(frames.frames[0])
    mask = next((p for p in pictures if MASK.search(p.stem) and p not in frames.frames), None)
    if mask is not None and image_size(mask) != size:
        raise UserError(mask, f"is {image_size(mask)} pixels, the frames {size}", "make the mask at the frames' size")
    path = camera_file(root, CAMERA)
    camera = read_camera(path, *size, name=CAMERA, distortion=config.olat.distortion) if path.is_file() else far_camera(*size)
    found = LightStageCamera(CAMERA, frames.frames, frames.frames, mask, camera, frames.full_light, "none")
    placed = [] if path.is_file() else ["no camera file: seen from far away, x to the right, y up, z towards the camera"]
    environments = find_environments(root)
    files = [*tables, *frames.frames, *([mask] if mask else []), *([path] if path.is_file() else [])]
    files += [root / "capture.toml"] if config.path is not None else []
    return Capture(
        root=root, layout="one_light_a_picture", kind="light_stage", polarisation="none",
        light_stage=LightStage(root, {CAMERA: found}, lights), environments=environments, config=config, up=config.up or "y",
        cameras={CAMERA: camera}, masks={CAMERA: mask} if mask else None, files=tuple([*files, *environments]),
        facts=tuple([*left_out_fact({CAMERA: frames}), *one_pass_facts({CAMERA: found}), *placed]),
        warnings=tuple(_unnamed(lights, pictures, tables[-1])),
    )  # fmt: skip


def _unnamed(lights: LightTable, pictures: list[Path], table: Path) -> list[str]:
    """A line where a table names pictures and none of them is here, so that lights go by number or in order."""
    if lights.names is None or frames_by_name(pictures, lights.names, table) is not None:
        return []
    fault = f"none of the pictures that the table names is here ({some(lights.names)})"
    return [f"{table}: {fault}: lights go to pictures in the order of their names; check it, or give them the table's names"]


def list_pictures(folder: Path) -> list[Path]:
    """The pictures that lie in a folder itself, sorted."""
    return [p for p in list_images(folder, IMAGE_SUFFIXES) if p.parent == folder]


def frames_of(pictures: list[Path], lights: LightTable, folder: Path, table: Path, first: int | None) -> PassFrames:
    """Each light's picture: by the names that the table tells, by number, or in order. Raises UserError."""
    named = frames_by_name(pictures, lights.names, table)
    if named is not None:
        return PassFrames(named)
    frames = [p for p in pictures if not NO_LIGHT.search(p.stem)]
    if not pictures:
        places = sorted({p.parent.relative_to(folder).as_posix() for p in list_images(folder, IMAGE_SUFFIXES)})
        fault = f"holds the pictures of {len(lights)} lights in folders that are not called as passes are ({some(places)})"
        raise UserError(folder, fault, f"call them cross and parallel; {WAY}")
    if len(frames) < len(lights):
        fault = f"lists {len(lights)} lights, but {folder} has {len(frames)} pictures"
        raise UserError(table, fault, f"add the missing pictures; {WAY}")
    if len(frames) == len(lights) and lights.index is None:
        return PassFrames(tuple(frames))
    if lights.index is None and first is None:
        fault = f"lists {len(lights)} lights, but {folder} has {len(frames)} pictures, and nothing says which are theirs"
        remedy = f"move the others away, or name each light's picture in filenames.txt beside {table.name}"
        raise UserError(table, fault, remedy)
    found = numbered(frames)
    index = np.arange(len(lights)) if lights.index is None else lights.index
    offset = first if first is not None else frame_offset(index, sorted(found), folder, table, leading=0)
    missing = [int(k) + offset for k in index if int(k) + offset not in found]
    if missing:
        raise UserError(folder, f"lacks picture {missing[0]} of {len(lights)} lights", "copy the missing pictures")
    chosen = tuple(found[int(k) + offset] for k in index)
    return PassFrames(chosen, left_out=tuple(p for p in frames if p not in set(chosen)))


def far_camera(width: int, height: int) -> Camera:
    """A camera on the z axis that looks back along it from so far that its rays are all but parallel; half the frame's width is
    one world unit."""
    pose = np.eye(4)
    pose[2, 3] = FAR
    focal = FAR * width / 2
    return Camera(width, height, focal, focal, width / 2, height / 2, camera_from_opengl(pose), name=CAMERA)


def _refuse_passes(table: Path, pictures: list[Path]) -> None:
    """Raise UserError where names tell that two passes lie in one folder."""
    found = {which for p in pictures for word in p.stem.replace("-", "_").split("_") if (which := pass_of(word))}
    if len(found) == len(PASSES):
        fault = "a light table: pictures behind crossed and parallel polarisers lie in one folder"
        raise UserError(table, fault, f"put each pass into a folder of its own; {WAY}")


LAYOUT = Layout(
    "one_light_a_picture", "a light table (lights.csv, NAME.lp, light_directions.txt) beside pictures", recognise, read
)
