"""nerfstudio's transforms.json beside Stokes EXRs, RGB behind polarisers, or plain photographs."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Literal

from pipeline.capture.assembly.assemble import find_plates
from pipeline.capture.assembly.sources import discover
from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture, ViewSource
from pipeline.capture.naming.files import (
    IMAGE_SUFFIXES,
    UNREADABLE,
    check_masks,
    count,
    find_environments,
    find_masks,
    list_images,
    polariser_priors,
    some,
    sorted_views,
)
from pipeline.capture.naming.grouping import Group
from pipeline.errors import UserError
from pipeline.formats.images import channel_names, image_size
from pipeline.formats.json_file import read_json
from pipeline.geometry.cameras import Camera, camera_from_frame

FILE = "transforms.json"
DEFAULT_CAMERA = "camera"
LONGEST_NAME = 4096  # Linux's PATH_MAX
MISPLACED = "put the images where file_path says"


def recognise(root: Path) -> bool:
    return (root / FILE).exists()


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture; matrices are camera-to-world with OpenGL axes. A frame may name a picture, a mosaic, a raw file,
    or the view that a stack's files begin with."""
    table = load_table(root / FILE)
    warnings: list[str] = []
    folder, paths = pictures_of(root, table["frames"])
    frame_of = frames_by_view(root, folder, table["frames"])

    def camera_of(group: Group) -> str:
        frame = frame_for(group, folder, frame_of)
        return DEFAULT_CAMERA if frame is None else physical_camera(frame, group.paths[0], folder, config)

    sources = discover(paths, folder, config, camera_of)
    if sources.kind == "stack" and any(_moves(g, folder, frame_of) for g in sources.groups):
        sources = discover(paths, folder, config, camera_of, kind="colour")  # names like angles, but each its own pose
    cameras: dict[str, Camera] = {}
    masks: dict[str, Path] = {}
    views: list[ViewSource] = []
    spare, used = [], set()
    for view, group in zip(sources.views, sources.groups):
        frame = frame_for(group, folder, frame_of)
        if frame is None:
            spare.append(group.paths[0].name)
            continue
        used.add(id(frame))
        cameras[view.view] = camera_of_view(frame, table, view, root)
        views.append(view)
        if frame.get("mask_path"):
            masks[view.view] = root / frame["mask_path"]
    missing = [
        f["file_path"] for f in table["frames"] if id(f) not in used and not _same_view_used(f, root, folder, frame_of, used)
    ]
    if not views:
        raise UserError(root / FILE, f"none of its {len(table['frames'])} images is there (first: {missing[0]})", MISPLACED)
    if missing:
        warnings.append(f"{root / FILE}: no image for {count(missing, 'camera')} ({some(missing)}); left out")
    if spare:
        warnings.append(f"{root / FILE}: no camera for {count(spare, 'image')} ({some(spare)}); left out")
    if not masks:
        masks, more = find_masks(root, {v.view: v.paths[0] for v in views}, folder)
        warnings += more
    for mask in masks.values():
        if not mask.is_file():
            raise UserError(mask, f"named in {FILE} but not there", "add it or remove its mask_path")
    check_masks(masks, lambda view: (cameras[view].width, cameras[view].height))
    told = bool(config.polarisers) or any("camera" in frame for frame in table["frames"])
    kind: Literal["stokes", "polarisers", "none"] = "stokes" if sources.holds_stokes else "polarisers" if told else "none"
    plates, plate_files = find_plates(root, config, tuple(views))
    environments = find_environments(root)
    alpha = not masks and all_have_alpha([v.paths[0] for v in views])
    name = {"stokes_files": "stokes_transforms", "colour": f"{'polarisers' if told else 'rgb'}_transforms"}
    return Capture(
        root, name.get(sources.kind, f"{sources.kind}_transforms"), "multiview", kind, sorted_views(views),
        environments=environments, config=config, up=config.up or "y", cameras=cameras,
        masks=masks or ("alpha" if alpha else None), warnings=tuple(warnings), facts=sources.facts, clean_plates=plates,
        polarisers=polariser_priors([v.camera for v in views], config, root) if kind == "polarisers" else {},
        files=(root / FILE, *(p for v in views for p in v.paths), *masks.values(), *plate_files, *environments),
    )  # fmt: skip


def pictures_of(root: Path, frames: list[dict[str, Any]]) -> tuple[Path, list[Path]]:
    """The folder that VIEW names are relative to, and the image files in question."""
    named = [existing(root / frame["file_path"]) for frame in frames]
    for path in named:
        if path.suffix.lower() in UNREADABLE:
            raise UserError(path, "cannot be read", UNREADABLE[path.suffix.lower()])
    folder = common_folder(root, named)
    there = [p for p in dict.fromkeys(named) if p.is_file()]
    if folder == root or not folder.is_dir():
        return folder, there
    return folder, sorted({*there, *list_images(folder)})


def existing(path: Path) -> Path:
    """The file that a frame means: as named, or with one of the image extensions."""
    if path.is_file():
        return path
    return next((q for q in (path.with_name(path.name + s) for s in sorted(IMAGE_SUFFIXES)) if q.is_file()), path)


def frames_by_view(root: Path, folder: Path, frames: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Frames by file (path below the folder) and by the VIEW that their path means. Raises UserError on duplicates."""
    out: dict[str, dict[str, Any]] = {}
    for frame in frames:
        relative = os.path.relpath(existing(root / frame["file_path"]), folder)
        if relative in out:
            raise UserError(root / FILE, f"two frames name {frame['file_path']}", "remove one of them")
        out[relative] = frame
    for relative, frame in list(out.items()):
        path = Path(relative)
        stem = path.with_suffix("").as_posix() if path.suffix.lower() in IMAGE_SUFFIXES else path.as_posix()
        out.setdefault(f"view:{stem.replace('/', '_')}", frame)
    return out


def frame_for(group: Group, folder: Path, frame_of: dict[str, dict[str, Any]]) -> dict[str, Any] | None:
    """The frame of a view: one that names any of its files, else the view itself."""
    for path in group.paths:
        frame = frame_of.get(os.path.relpath(path, folder))
        if frame is not None:
            return frame
    return frame_of.get(f"view:{group.view}")


def _moves(group: Group, folder: Path, frame_of: dict[str, dict[str, Any]]) -> bool:
    """Whether the files of one would-be stack have frames with different matrices."""
    found = [frame_of.get(os.path.relpath(p, folder)) for p in group.paths]
    return len({json.dumps(f["transform_matrix"]) for f in found if f is not None and "transform_matrix" in f}) > 1


def _same_view_used(
    frame: dict[str, Any], root: Path, folder: Path, frame_of: dict[str, dict[str, Any]], used: set[int]
) -> bool:
    """Whether a frame's file belongs to a view that another frame stands for (frames that list a stack file by file)."""
    path = existing(root / frame["file_path"])
    return path.is_file() and bool(used)


def camera_of_view(frame: dict[str, Any], table: dict[str, Any], view: ViewSource, root: Path) -> Camera:
    """The frame's camera, which must have the picture's size. Raises UserError."""
    size = view.size or image_size(view.paths[0])
    frame = {**frame, "camera": view.camera}
    if "w" not in frame and "w" not in table:
        frame["w"], frame["h"] = size
    camera = camera_from_frame(frame, table, root / FILE)
    if (camera.width, camera.height) != size:
        turned = ", turned by 90° (EXIF rotation is not applied)" if (camera.height, camera.width) == size else ""
        fault = f"is {size[0]}x{size[1]}, its camera in {FILE} is {camera.width}x{camera.height}{turned}"
        raise UserError(view.paths[0], fault, "give the camera the image's size")
    return camera


def load_table(path: Path) -> dict[str, Any]:
    """The parsed transforms.json with at least one frame. Raises UserError."""
    table = read_json(path)
    frames = table.get("frames") if isinstance(table, dict) else None
    if not isinstance(frames, list) or not frames:
        raise UserError(path, "holds no frames", 'it needs "frames": [{"file_path", "transform_matrix"}, ...]')
    for frame in frames:
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise UserError(path, "a frame has no file_path", "name the image of every frame")
        if not isinstance(frame.get("mask_path") or "", str):
            fault = f"frame {frame['file_path']}: mask_path = {frame['mask_path']!r} is not text"
            raise UserError(path, fault, "name the frame's mask, or leave it out")
        for key in ("file_path", "mask_path"):
            if len(frame.get(key) or "") > LONGEST_NAME or "\0" in (frame.get(key) or ""):
                raise UserError(path, f"a frame's {key} is no file name ({frame[key][:40]!r}...)", "name the frame's file")
    return table


def common_folder(root: Path, paths: list[Path]) -> Path:
    """The folder that VIEW names are relative to: the first folder below the capture, if all images share it."""
    tops = {Path(os.path.relpath(p, root)).parts[0] if len(Path(os.path.relpath(p, root)).parts) > 1 else "" for p in paths}
    return root / tops.pop() if len(tops) == 1 else root


def physical_camera(frame: dict[str, Any], path: Path, folder: Path, config: CaptureConfig) -> str:
    """The camera (= polariser) behind a frame: told by the frame, else by a folder that capture.toml names."""
    if "camera" in frame:
        return str(frame["camera"])
    named = [part for part in path.relative_to(folder).parts[:-1] if part in config.polarisers]
    return named[0] if named else DEFAULT_CAMERA


def all_have_alpha(paths: list[Path]) -> bool:
    """Whether every image carries an alpha channel (headers only)."""
    return all(p.suffix.lower() in (".png", ".tif", ".tiff", ".exr") and "A" in channel_names(p) for p in paths)


LAYOUT = Layout(
    "transforms", "transforms.json and its images (Stokes EXR, RGB behind polarisers, or photographs)", recognise, read
)
