"""Which layout is this folder? Ask every reader, the more specific first."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from pipeline.capture.config import load_config
from pipeline.capture.layouts import all_layouts
from pipeline.capture.light_stage.beside_views import folder_beside, idle_words, joined, read_beside
from pipeline.capture.model import Capture
from pipeline.capture.naming.files import ARCHIVES, refuse_duplicates
from pipeline.capture.naming.safe_names import refuse_special_files
from pipeline.capture.recognition.copies import copied_pictures
from pipeline.capture.recognition.foreign import (
    foreign_warnings,
    lost_links,
    refuse_dataset,
    refuse_unreadable,
    refuse_without_pictures,
)
from pipeline.capture.recognition.idle_tables import exposures_for_some, polarisers_alike, refuse_idle_tables
from pipeline.capture.recognition.misnamed_settings import misnamed_settings
from pipeline.errors import UserError
from pipeline.geometry.camera_check import one_pose_words, outside_words, refuse_one_place

LIGHT_STAGES = ("open_illumination", "ict_light_stage", "one_light_a_picture")
"""Layouts that a folder olat/ is read by, and not what lies beside it."""
SHOWN = 12
"""Entries of an unknown folder that its error message lists."""


def open_capture(path: Path | str) -> Capture:
    """Recognise and check a capture folder.

    Args:
        path: the folder.

    Returns:
        What it is; no pixels have been read but where radiometry had to be found out.

    Raises:
        UserError: the folder is missing, empty or of no known layout (names what was looked for and what was found), or the
            recognised layout's reader finds it wrong.
    """
    root = Path(os.path.abspath(path))
    if not root.exists():
        raise UserError(root, "there is no such folder", "give CAPTURE= the folder that holds the images")
    if not root.is_dir():
        way = "unpack it and " if root.suffix.lower() in ARCHIVES else ""
        raise UserError(root, "is a file, not a capture folder", f"{way}give CAPTURE= the folder that holds the images")
    try:
        shown = [name for name in os.listdir(root) if not name.startswith(".")]
        entries = sorted(name + "/" * os.path.isdir(root / name) for name in shown)
    except PermissionError:
        raise UserError(root, "cannot be read: permission denied", "make the folder readable") from None
    if not entries:
        raise UserError(root, "the folder is empty", "give CAPTURE= a folder with images; docs/captures.md lists the layouts")
    refuse_special_files(root)
    refuse_dataset(root)
    config = load_config(root)
    layouts = all_layouts()
    beside = folder_beside(root)
    if config.layout is not None:
        chosen = [layout for layout in layouts if layout.name == config.layout]
        if not chosen:
            names = ", ".join(layout.name for layout in layouts)
            raise UserError(root / "capture.toml", f"layout = {config.layout!r} is not a layout", f"known: {names}")
        return _with_stage(chosen[0].read(root, config), beside)
    for layout in layouts:
        if (beside is None or layout.name not in LIGHT_STAGES) and layout.recognise(root):
            return _with_stage(layout.read(root, config), beside)
    if beside is not None:
        return open_capture(beside)
    refuse_unreadable(root)
    refuse_without_pictures(root)
    looked = "; ".join(f"{layout.name}: {layout.looks_like}" for layout in layouts)
    found = ", ".join(entries[:SHOWN]) + (f" and {len(entries) - SHOWN} more" if len(entries) > SHOWN else "")
    raise UserError(
        root,
        f"no known capture layout. Found: {found}. Looked for {looked}",
        "see docs/captures.md, or set `layout` in capture.toml",
    )


def _with_stage(capture: Capture, folder: Path | None) -> Capture:
    """A capture, checked, with the light stage in `folder` where it is one of views."""
    views = _checked(capture)
    views = replace(views, warnings=(*views.warnings, *idle_words(views)))
    return views if folder is None or views.kind != "multiview" else joined(views, _checked(read_beside(views, folder)))


def _checked(capture: Capture) -> Capture:
    """The capture, if what its parts say fits together, with warnings for files among its images that nobody here reads."""
    refuse_duplicates((view.view, view.paths[0]) for view in capture.views)
    if capture.kind == "multiview" and capture.cameras:
        refuse_one_place(capture.cameras, capture.camera_file)
    refuse_idle_tables(capture)
    given = capture.cameras if capture.kind == "multiview" and capture.cameras else {}
    twins = (*one_pose_words(given, capture.camera_file), *outside_words(given, capture.camera_file))
    files = (*copied_pictures(capture), *foreign_warnings(capture), *lost_links(capture.root))
    found = (*twins, *misnamed_settings(capture.root), *exposures_for_some(capture), *polarisers_alike(capture), *files)
    return replace(capture, warnings=(*capture.warnings, *found))
