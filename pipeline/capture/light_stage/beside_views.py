"""A light stage of the same object beside a capture's views: the folder olat/, a capture of its own in the views' world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pipeline.capture.config import load_config
from pipeline.capture.layouts import ict_light_stage
from pipeline.capture.light_stage.folders import stage_folders
from pipeline.capture.light_stage.given_cameras import cameras_of_views
from pipeline.capture.light_stage.read_light_table import table_beside
from pipeline.capture.model import Capture
from pipeline.capture.naming.files import OLAT, count


def folder_beside(root: Path) -> Path | None:
    """Find the light stage that may lie beside a capture's views.

    Args:
        root: the capture's folder.

    Returns:
        Its folder olat/, whatever its case; None where that holds no frames of passes, or no light table of its own, or where
        other folders hold passes too: then all of them are one light stage.
    """
    folders = [p for p in sorted(root.iterdir()) if p.name.lower() == OLAT and p.is_dir()]
    found = next((p for p in folders if table_beside(p) is not None and stage_folders(p)), None)
    if found is None or any(not camera.home.is_relative_to(found) for camera in stage_folders(root).values()):
        return None
    return found


def idle_words(capture: Capture) -> list[str]:
    """Say what beside a capture's views looks like a light stage and is none of it.

    Args:
        capture: of views, as recognised.

    Returns:
        A line where its folder olat/ has no light table, or where a light table lies beside views that have cameras.
    """
    if capture.kind != "multiview" or folder_beside(capture.root) is not None:
        return []
    lines = []
    for folder in (p for p in sorted(capture.root.iterdir()) if p.name.lower() == OLAT and p.is_dir()):
        if table_beside(folder) is None and stage_folders(folder):
            lines.append(f"{folder}: holds passes of a light stage and no light table, and is not used: add lights.csv to it")
    if (table := table_beside(capture.root)) is not None:
        lines.append(f"{table}: a light table beside views is not used: put a light stage of theirs into {OLAT}/ with it")
    return lines


def read_beside(views: Capture, folder: Path) -> Capture:
    """Open the light stage beside a capture's views.

    Args:
        views: the multi-view capture.
        folder: its olat/, with a capture.toml of its own.

    Returns:
        The light stage. Cameras that it does not have itself are those of the views of the same number (cam03 and VIEW cam03).

    Raises:
        UserError: names the file at fault.
    """
    given = cameras_of_views(views.cameras, views.camera_file) if views.cameras else None
    return ict_light_stage.read(folder, load_config(folder), given)


def joined(views: Capture, stage: Capture) -> Capture:
    """Make one capture of views and the light stage beside them.

    Args:
        views: the multi-view capture.
        stage: what `read_beside` made of its folder olat/, checked.

    Returns:
        The views' capture, with the light stage, its files, and what there is to say of it.
    """
    assert stage.light_stage is not None
    rig = stage.light_stage
    what = f"{count(rig.cameras, 'camera')} under {len(rig.lights)} lights"
    files = [path for path in stage.files if path not in stage.environments]
    facts = [f"{stage.root.name}/: a light stage of {what}", *(f"{stage.root.name}/: {fact}" for fact in stage.facts)]
    warnings = (*views.warnings, *stage.warnings)
    return replace(views, olat=stage, files=(*views.files, *files), facts=(*views.facts, *facts), warnings=warnings)
