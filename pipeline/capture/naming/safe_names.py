"""Names from a capture that become names of files which stages write: each must be one plain name."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from pipeline.capture.model import Capture
from pipeline.errors import UserError

LONGEST = 240  # bytes; file systems take 255, and endings such as _olat.exr are added
RESERVED = ("", ".", "..", "manifest.json")
LOOKED_AT = 200_000  # entries of a folder that are looked at: the folder of a whole disk is no capture


def fault_of_name(name: str) -> str | None:
    """Say why a name cannot be a file's in a dataset.

    Args:
        name: without extension.

    Returns:
        Words that follow the name; None where it can.
    """
    if any("\ud800" <= c <= "\udfff" for c in name):
        return "is no text in UTF-8"
    if len(name.encode()) > LONGEST:
        return f"is {len(name.encode())} bytes long ({LONGEST} fit)"
    if name in RESERVED or "/" in name or "\0" in name:
        return "is no name of a file"
    return None


def environment_name(path: Path) -> str:
    """Name what is computed under an environment map.

    Args:
        path: the map's file.

    Returns:
        Its name without extension; with "map_" before it where that is no plain name.
    """
    return path.stem if path.stem not in RESERVED else f"map_{path.stem}"


def refuse_unsafe_names(capture: Capture) -> None:
    """Refuse a capture with a view, light-stage camera or map whose name no file can have.

    Args:
        capture: as recognised.

    Raises:
        UserError: names the first of them.
    """
    for what, name, path in _names(capture):
        if fault := fault_of_name(name):
            raise UserError(path, f"the name of its {what} {_shown(name)} {fault}", "rename the file")


def refuse_special_files(root: Path) -> None:
    """Raise UserError where a folder holds a pipe, a socket or a device, which would be read for ever."""
    for entry in _entries(root):
        try:
            if entry.is_file() or entry.is_dir():
                continue
            mode = entry.stat().st_mode
        except OSError:
            continue  # a link to nothing, or to itself
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise UserError(entry.path, "is not a regular file, but a pipe, a socket or a device", "remove it from the capture")


def _entries(root: Path) -> Iterator[os.DirEntry[str]]:
    folders, seen = [os.fspath(root)], 0
    while folders:
        try:
            with os.scandir(folders.pop()) as found:
                for entry in found:
                    seen += 1
                    yield entry
                    if entry.is_dir(follow_symlinks=False):
                        folders.append(entry.path)
        except OSError:
            continue  # readers name a folder that cannot be read, if it matters
        if seen > LOOKED_AT:
            return


def _names(capture: Capture) -> Iterable[tuple[str, str, Path]]:
    for view in capture.views:
        yield "view", view.view, view.paths[0] if view.paths else capture.root
    for name in capture.light_stage.cameras if capture.light_stage else ():
        yield "camera", name, capture.root
    for path in capture.environments:
        yield "map", environment_name(path), path


def _shown(name: str) -> str:
    text = repr(name)
    return text if len(text) <= 60 else f"{text[:40]}..."
