"""Angle stacks: one file per view and polariser angle (VIEW_000, VIEW_045, ...; or folders by angle)."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture.assembly.assemble import assemble
from pipeline.capture.assembly.sources import discover
from pipeline.capture.config import CaptureConfig, load_config
from pipeline.capture.layouts import Layout
from pipeline.capture.layouts.photographs import pictures
from pipeline.capture.layouts.photographs import recognise as has_pictures
from pipeline.capture.model import Capture
from pipeline.capture.naming.files import image_folder, list_images
from pipeline.capture.naming.grouping import group_files
from pipeline.errors import UserError


def recognise(root: Path) -> bool:
    if not has_pictures(root):
        return False
    folder = image_folder(root)
    config = load_config(root)
    try:
        paths = pictures(root)[1] if folder == root else list_images(folder)
    except UserError:  # nothing readable: the last layout says so
        return False
    return bool(paths) and any(g.is_stack for g in group_files(paths, folder, config))


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture; Stokes vectors come from weighted least squares over the angles."""
    folder, paths = pictures(root)
    sources = discover(paths, folder, config, lambda _: "camera", kind="stack")
    if sources.kind != "stack":
        raise UserError(
            folder, "its names tell no polariser angles", "name files VIEW_000, VIEW_045, ... or set [stack] angles_deg"
        )
    return assemble(root, "angle_stack", config, folder, sources.views, "stokes", facts=sources.facts, warned=sources.warnings)


LAYOUT = Layout("angle_stack", "images/VIEW_000.png, VIEW_045.png, ... (any three or more angles)", recognise, read)
