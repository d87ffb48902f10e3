"""Plain photographs (or camera raw): colour only, unless capture.toml names polarisers; COLMAP model if there is one."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pipeline.capture.assembly.assemble import assemble, folder_camera, outside_images
from pipeline.capture.assembly.sources import discover
from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture
from pipeline.capture.naming.files import IMAGE_SUFFIXES, UNREADABLE, has_images, image_folder, list_images
from pipeline.errors import UserError


def recognise(root: Path) -> bool:
    return any(has_images(p) for p in root.iterdir() if p.is_dir() and not outside_images(p)) or bool(loose_images(root))


def loose_images(root: Path) -> list[Path]:
    """Image files that lie in the capture's folder itself."""
    wanted = set(IMAGE_SUFFIXES) | set(UNREADABLE)
    return sorted(
        p for p in root.iterdir() if p.is_file() and p.suffix.lower() in wanted and not p.stem.startswith("clean_plate")
    )


def pictures(root: Path) -> tuple[Path, list[Path]]:
    """The image folder and its files. Raises UserError where every file is of a kind that nobody can read."""
    folder = image_folder(root)
    paths = (
        list_images(folder)
        if folder != root
        else [p for p in list_images(root) if not any(outside_images(q) for q in p.parents)]
    )
    if not paths:
        raise UserError(folder, "holds no image", "copy the photographs into it")
    return folder, paths


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open a folder of photographs."""
    folder, paths = pictures(root)
    sources = discover(paths, folder, config, lambda g: folder_camera(g.paths, folder, config), kind="colour")
    polarisation: Literal["stokes", "polarisers", "none"]
    polarisation = "stokes" if sources.holds_stokes else "polarisers" if config.polarisers else "none"
    return assemble(
        root, "photographs", config, folder, sources.views, polarisation, facts=sources.facts, warned=sources.warnings
    )


LAYOUT = Layout("photographs", "images/ with photographs or camera raw files, a COLMAP model if there is one", recognise, read)
