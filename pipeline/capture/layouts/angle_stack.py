"""Angle stacks: one file per view and polariser angle (VIEW_000, VIEW_045, ...; or folders by angle)."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture.config import CaptureConfig, load_config
from pipeline.capture.layouts import Layout
from pipeline.capture.layouts.photographs import pictures, read_as
from pipeline.capture.layouts.photographs import recognise as has_pictures
from pipeline.capture.model import Capture
from pipeline.capture.naming.grouping import group_files
from pipeline.capture.naming.pages import angle_pages
from pipeline.errors import UserError


def recognise(root: Path) -> bool:
    if not has_pictures(root):
        return False
    config = load_config(root)
    if config.stack.angles_deg:
        return True
    try:
        found = pictures(root, config)
    except UserError:  # nothing readable: the last layout says so
        return False
    try:
        named = any(g.is_stack for g in group_files(found.paths, found.folder, config))
        return named or bool(angle_pages(found.paths[0], config))
    except UserError:  # about as many files fit as do not, or pages tell no angles: the reader says so
        return True


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture; Stokes vectors come from weighted least squares over the angles."""
    capture = read_as(root, config, "angle_stack", "stack")
    if not any(fact.startswith("stacks") for fact in capture.facts):
        folder = capture.views[0].paths[0].parent
        raise UserError(
            folder, "its names tell no polariser angles", "name files VIEW_000, VIEW_045, ... or set [stack] angles_deg"
        )
    return capture


LAYOUT = Layout("angle_stack", "images/VIEW_000.png, VIEW_045.png, ... (any three or more angles)", recognise, read)
