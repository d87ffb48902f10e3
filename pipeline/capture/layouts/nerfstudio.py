"""nerfstudio's transforms.json beside Stokes EXRs, RGB behind polarisers, or plain photographs."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from pipeline.capture.assembly.assemble import alpha_of, find_plates
from pipeline.capture.assembly.sources import discover
from pipeline.capture.camera_files.transforms_json import FILE, NerfFrame, captures_below, held_out, load_frames, table_files
from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture, Polarisation, ViewSource
from pipeline.capture.naming.beside_images import is_beside
from pipeline.capture.naming.files import (
    IMAGE_FOLDERS,
    IMAGE_SUFFIXES,
    UNREADABLE,
    count,
    find_environments,
    list_images,
    polariser_priors,
    some,
    sorted_views,
)
from pipeline.capture.naming.grouping import Group
from pipeline.capture.naming.masks import check_masks, find_masks
from pipeline.capture.recognition.stray_files import sort_out
from pipeline.errors import UserError
from pipeline.formats.bare_arrays import ARRAY_SUFFIXES
from pipeline.formats.images import image_size
from pipeline.geometry.cameras import Camera, camera_from_frame

DEFAULT_CAMERA = "camera"
CHECK = "check the file_path of its frames"
CHECK_CAMERA = "check whose polariser they are behind"
MISPLACED = "put the images where file_path says"


def recognise(root: Path) -> bool:
    return bool(table_files(root) or captures_below(root))


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture; matrices are camera-to-world with OpenGL axes. A frame may name a picture, a mosaic, a raw file,
    or the view that a stack's files begin with."""
    files = table_files(root)
    if not files:
        several = ", ".join(f"{p.name}/" for p in captures_below(root))
        raise UserError(root, f"holds several captures ({several})", "give one of these folders as CAPTURE=")
    frames = load_frames(files)
    where = files[0]
    folder, paths, warnings = pictures_of(root, frames)
    frame_of = frames_by_view(folder, frames)

    def camera_of(group: Group) -> str:
        frame = frame_for(group, folder, frame_of)
        return DEFAULT_CAMERA if frame is None else physical_camera(frame.entry, group.paths[0], folder, config)

    def is_named(group: Group) -> bool:
        return frame_for(group, folder, frame_of) is not None

    sources = discover(paths, folder, config, camera_of, is_named=is_named)
    if sources.kind == "stack" and any(_moves(g, folder, frame_of) for g in sources.groups):
        # names like angles, but each its own pose
        sources = discover(paths, folder, config, camera_of, kind="colour", is_named=is_named)
    cameras: dict[str, Camera] = {}
    masks: dict[str, Path] = {}
    views: list[ViewSource] = []
    parts: dict[str, str] = {}
    spare, used = [p.name for p in sources.unnamed], set()
    for view, group in zip(sources.views, sources.groups):
        frame = frame_for(group, folder, frame_of)
        if frame is None:
            spare.append(group.paths[0].name)
            continue
        used.add(id(frame))
        cameras[view.view] = camera_of_view(frame.entry, frame.table, view, frame.where)
        views.append(view)
        parts[view.view] = frame.part
        if frame.entry.get("mask_path"):
            masks[view.view] = mask_of(frame)
    missing = [f.entry["file_path"] for f in frames if id(f) not in used and not (f.path.is_file() and used)]
    if not views:
        raise UserError(where, f"none of its {len(frames)} images is there (first: {frames[0].entry['file_path']})", MISPLACED)
    warnings += sources.warnings
    if missing:
        warnings.append(f"{where}: no image for {count(missing, 'camera')} ({some(missing)}); left out: {CHECK}")
    if spare:
        warnings.append(f"{where}: no camera for {count(spare, 'image')} ({some(spare)}); left out: {CHECK}")
    if not masks:
        masks, more = find_masks(root, {v.view: v.paths[0] for v in views}, folder)
        warnings += more
    elif len(masks) < len(views):
        without = [v.view for v in views if v.view not in masks]
        warnings.append(f"{where}: no mask_path for {count(without, 'view')} ({some(without)}): these are segmented")
    for mask in masks.values():
        if not mask.is_file():
            raise UserError(mask, f"named in {where.name} but not there", "add it or remove its mask_path")
    check_masks(masks, lambda view: (cameras[view].width, cameras[view].height))
    nameless = [frame.entry["file_path"] for frame in frames if "camera" not in frame.entry]
    polarised = bool(config.polarisers) or len(nameless) < len(frames)
    if 0 < len(nameless) < len(frames):
        warnings.append(f"{where}: {count(nameless, 'frame')} ({some(nameless)}) name no camera, others do: {CHECK_CAMERA}")
    kind: Polarisation = "stokes" if sources.holds_stokes else "polarisers" if polarised else "none"
    plates, plate_files = find_plates(root, config, tuple(views))
    environments = find_environments(root)
    alpha, words = (False, []) if masks else alpha_of(views)
    name = {"stokes_files": "stokes_transforms", "colour": f"{'polarisers' if polarised else 'rgb'}_transforms"}
    cameras_from = "cameras: " + ", ".join(_below(p, root) for p in files)
    facts = sources.facts if files == [root / FILE] else (*sources.facts, cameras_from)
    return Capture(
        root, name.get(sources.kind, f"{sources.kind}_transforms"), "multiview", kind, sorted_views(views),
        environments=environments, config=config, up=config.up or "y", cameras=cameras, parts=held_out(parts),
        masks=masks or ("alpha" if alpha else None), warnings=(*warnings, *words), facts=facts, clean_plates=plates,
        polarisers=polariser_priors([v.camera for v in views], config) if kind == "polarisers" else {},
        files=(*files, *(p for v in views for p in v.paths), *masks.values(), *plate_files, *environments),
    )  # fmt: skip


def _below(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix()


def pictures_of(root: Path, frames: list[NerfFrame]) -> tuple[Path, list[Path], list[str]]:
    """The folder that VIEW names are relative to, the image files in question, and what was left out of them.

    Nothing is listed outside the capture: of a folder elsewhere only the files that frames name are read.
    """
    for frame in frames:
        if frame.path.suffix.lower() in UNREADABLE and frame.path.is_file():
            raise UserError(frame.path, "cannot be read", UNREADABLE[frame.path.suffix.lower()])
    folder = _image_folder(root, frames)
    there = [p for p in dict.fromkeys(f.path for f in frames) if p.is_file()]
    if apart := next((p for p in there if not p.is_relative_to(folder)), None):
        raise UserError(root, f"its frames name {apart}, which lies apart from the other images", "put all below one folder")
    if folder == root or not folder.is_dir() or not Path(os.path.normpath(folder)).is_relative_to(root):
        return folder, there, []
    listed = list_images(folder)
    if folder.name not in IMAGE_FOLDERS:
        listed = [p for p in listed if not is_beside(p, root)]
    chosen = sort_out(sorted({*there, *listed}), folder, {p.stem for p in there})
    return folder, chosen.kept, chosen.warnings()


def _image_folder(root: Path, frames: list[NerfFrame]) -> Path:
    """The folder of the frames' images, below the table's own where they all lie there."""
    paths, home = [f.path for f in frames], frames[0].where.parent
    return common_folder(home if all(Path(os.path.normpath(p)).is_relative_to(home) for p in paths) else root, paths)


def mask_of(frame: NerfFrame) -> Path:
    """The file of a frame's mask_path."""
    named = frame.entry["mask_path"]
    path = frame.where.parent / named
    plain = frame.where.parent / named.replace("\\", "/")
    return path if path.is_file() else plain


def frames_by_view(folder: Path, frames: list[NerfFrame]) -> dict[str, NerfFrame]:
    """Frames by file (path below the folder) and by the VIEW that their path means. Raises UserError on duplicates."""
    out: dict[str, NerfFrame] = {}
    for frame in frames:
        relative = os.path.relpath(frame.path, folder)
        if relative in out:
            raise UserError(frame.where, f"two frames name {frame.entry['file_path']}", "remove one of them")
        out[relative] = frame
    for relative, frame in list(out.items()):
        path = Path(relative)
        stem = path.with_suffix("").as_posix() if path.suffix.lower() in IMAGE_SUFFIXES | ARRAY_SUFFIXES else path.as_posix()
        out.setdefault(f"view:{stem.replace('/', '_')}", frame)
    return out


def frame_for(group: Group, folder: Path, frame_of: dict[str, NerfFrame]) -> NerfFrame | None:
    """The frame of a view: one that names any of its files, else the view itself."""
    for path in group.paths:
        frame = frame_of.get(os.path.relpath(path, folder))
        if frame is not None:
            return frame
    return frame_of.get(f"view:{group.view}")


def _moves(group: Group, folder: Path, frame_of: dict[str, NerfFrame]) -> bool:
    """Whether the files of one would-be stack have frames with different matrices."""
    found = [frame_of.get(os.path.relpath(p, folder)) for p in group.paths]
    return len({json.dumps(f.entry["transform_matrix"]) for f in found if f is not None and "transform_matrix" in f.entry}) > 1


def camera_of_view(frame: dict[str, Any], table: dict[str, Any], view: ViewSource, where: Path) -> Camera:
    """The camera of a frame of the table `where`, which must have the picture's size. Raises UserError."""
    size = view.size or image_size(view.paths[0])
    frame = {**frame, "camera": view.camera}
    if "w" not in frame and "w" not in table:
        frame["w"], frame["h"] = size
    camera = camera_from_frame(frame, table, where)
    if (camera.width, camera.height) != size:
        turned = ", turned by 90° (EXIF rotation is not applied)" if (camera.height, camera.width) == size else ""
        fault = f"is {size[0]}x{size[1]}, its camera in {where.name} is {camera.width}x{camera.height}{turned}"
        raise UserError(view.paths[0], fault, "give the camera the image's size")
    return camera


def common_folder(root: Path, paths: list[Path]) -> Path:
    """The folder that VIEW names are relative to: the first folder below the capture, if all images share it."""
    tops = {Path(os.path.relpath(p, root)).parts[0] if len(Path(os.path.relpath(p, root)).parts) > 1 else "" for p in paths}
    return root / tops.pop() if len(tops) == 1 else root


def physical_camera(frame: dict[str, Any], path: Path, folder: Path, config: CaptureConfig) -> str:
    """The camera (= polariser) behind a frame: named by the frame, else by a folder that capture.toml names."""
    if "camera" in frame:
        return str(frame["camera"])
    named = [part for part in path.relative_to(folder).parts[:-1] if part in config.polarisers]
    return named[0] if named else DEFAULT_CAMERA


LAYOUT = Layout(
    "transforms", "transforms.json and its images (Stokes EXR, RGB behind polarisers, or photographs)", recognise, read
)
