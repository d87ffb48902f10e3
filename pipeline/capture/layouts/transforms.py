"""nerfstudio's transforms.json beside Stokes EXRs, RGB behind polarisers, or plain photographs."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Literal

from pipeline.cameras import Camera, camera_from_frame
from pipeline.capture.config import CaptureConfig
from pipeline.capture.files import (
    FLOAT_SUFFIXES,
    IMAGE_SUFFIXES,
    UNREADABLE,
    check_masks,
    count,
    find_environments,
    find_masks,
    list_images,
    polariser_priors,
    refuse_duplicates,
    some,
    sorted_views,
    view_name,
)
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture, ViewSource
from pipeline.capture.stokes_files import holds_stokes, rgb_loader, stokes_exr_loader
from pipeline.errors import UserError
from pipeline.images import channel_names, image_size

FILE = "transforms.json"
DEFAULT_CAMERA = "camera"


def recognise(root: Path) -> bool:
    return (root / FILE).exists()


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture; matrices are camera-to-world with OpenGL axes."""
    table = load_table(root / FILE)
    warnings: list[str] = []
    found = find_images(root, table["frames"], warnings)
    folder = common_folder(root, [path for _, path in found])
    named = [(view_name(path, folder), frame, path) for frame, path in found]
    refuse_duplicates((view, path) for view, _, path in named)
    used = {path for _, _, path in named}
    spare = [p for p in list_images(folder) if p not in used] if folder != root else []
    if spare:
        warnings.append(f"{root / FILE}: no camera for {count(spare, 'image')} ({some(p.name for p in spare)}); left out")

    polarisation, channels = "none", {}
    for view, _, path in named:
        channels[view] = channel_names(path) if path.suffix.lower() in FLOAT_SUFFIXES else ["R", "G", "B"]
    stokes = {view for view, names in channels.items() if holds_stokes(names)}
    if stokes and len(stokes) != len(named):
        odd = next(path for view, _, path in named if view not in stokes)
        raise UserError(odd, f"holds no Stokes channels while {count(stokes, 'other image')} do", "export every image alike")
    if stokes:
        polarisation = "stokes"
    elif config.polarisers or any("camera" in frame for _, frame, _ in named):
        polarisation = "polarisers"

    cameras: dict[str, Camera] = {}
    views, masks = [], {}
    for view, frame, path in named:
        size = image_size(path)
        frame = {**frame, "camera": physical_camera(frame, path, folder, config)}
        if "w" not in frame and "w" not in table:
            frame["w"], frame["h"] = size
        camera = camera_from_frame(frame, table, root / FILE)
        if (camera.width, camera.height) != size:
            raise UserError(
                path,
                f"is {size[0]}x{size[1]}, its camera in {FILE} is {camera.width}x{camera.height}",
                "give the camera the image's size",
            )
        cameras[view] = camera
        loader = stokes_exr_loader(path, config) if stokes else rgb_loader(path, config, view)
        views.append(ViewSource(view, (path,), camera.name, loader, size))
        if frame.get("mask_path"):
            masks[view] = root / frame["mask_path"]
    if not masks:
        masks, more = find_masks(root, {view: path for view, _, path in named}, folder)
        warnings += more
    for mask in masks.values():
        if not mask.is_file():
            raise UserError(mask, f"named in {FILE} but not there", "add it or remove its mask_path")
    check_masks(masks, lambda view: (cameras[view].width, cameras[view].height))
    with_alpha = all("A" in names for names in channels.values()) or all_have_alpha([p for _, _, p in named])
    environments = find_environments(root)
    kind: Literal["stokes", "polarisers", "none"] = polarisation  # type: ignore[assignment]
    return Capture(
        root, {"stokes": "stokes_transforms", "polarisers": "polarisers_transforms", "none": "rgb_transforms"}[kind],
        "multiview", kind, sorted_views(views), environments=environments, config=config, up=config.up or "y",
        cameras=cameras, masks=masks or ("alpha" if with_alpha else None), warnings=tuple(warnings),
        polarisers=polariser_priors([v.camera for v in views], config, root) if kind == "polarisers" else {},
        files=(root / FILE, *(p for _, _, p in named), *masks.values(), *environments),
    )  # fmt: skip


def load_table(path: Path) -> dict[str, Any]:
    """The parsed transforms.json with at least one frame. Raises UserError."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UserError(path, f"is not valid JSON ({error})", "export it again") from None
    frames = table.get("frames") if isinstance(table, dict) else None
    if not isinstance(frames, list) or not frames:
        raise UserError(path, "holds no frames", 'it needs "frames": [{"file_path", "transform_matrix"}, ...]')
    for frame in frames:
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise UserError(path, "a frame has no file_path", "name the image of every frame")
    return table


def find_images(root: Path, frames: list[dict[str, Any]], warnings: list[str]) -> list[tuple[dict[str, Any], Path]]:
    """The image file of every frame (a missing extension is found), without the frames whose image is gone."""
    found, missing = [], []
    for frame in frames:
        path = root / frame["file_path"]
        if not path.is_file():
            near = [path.with_name(path.name + s) for s in sorted(IMAGE_SUFFIXES) if path.with_name(path.name + s).is_file()]
            path = near[0] if near else path
        if path.suffix.lower() in UNREADABLE:
            raise UserError(path, "cannot be read", UNREADABLE[path.suffix.lower()])
        if path.is_file():
            found.append((frame, path))
        else:
            missing.append(frame["file_path"])
    if not found:
        raise UserError(
            root / FILE,
            f"none of its {len(frames)} images is there (first: {missing[0]})",
            "put the images where file_path says",
        )
    if missing:
        warnings.append(f"{root / FILE}: no image for {count(missing, 'camera')} ({some(missing)}); left out")
    return found


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
