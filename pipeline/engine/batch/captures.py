"""Which captures a batch is of: the captures in a folder, or those that a list names, each with a dataset of its own name."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pipeline.capture.naming.safe_names import fault_of_name
from pipeline.errors import UserError

MAPS = ("envmaps",)  # beside captures: maps that they share
DEEPEST = 3  # folders between the batch's folder and a capture


@dataclass(frozen=True)
class Place:
    """One capture of a batch: the name of its row and of its dataset, and where it lies."""

    name: str
    capture: Path


def places_of(source: Path) -> list[Place]:
    """The captures of a batch, by name. `source`: a folder of captures, or a text file with a path a line (`#`: a remark).

    Paths of a list are relative to it. Raises UserError where there is none, or one is named twice.
    """
    if source.is_dir():
        found = sorted(_below(source, DEEPEST))
        if not found:
            raise UserError(source, "holds no folder with files in it", "give the folder that the captures lie in")
        return _named(found, source)
    if not source.exists():
        raise UserError(source, "no such folder or list", "give a folder of captures, or a text file with a path a line")
    return _named(_listed(source), source.parent)


def _below(folder: Path, depth: int) -> Iterable[Path]:
    """Folders that hold files, or folders of files that belong together; a dataset is none, nor are maps."""
    for path in sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".")):
        if path.name in MAPS or (path / "dataset.json").exists():
            continue
        inner = [p for p in path.iterdir() if not p.name.startswith(".")]
        if depth > 1 and inner and all(p.is_dir() for p in inner) and not _is_one_capture(path):
            yield from _below(path, depth - 1)
        elif inner:
            yield path


def _is_one_capture(folder: Path) -> bool:
    """Whether a folder of folders (cameras, polarisers) is one capture."""
    from pipeline.capture import open_capture

    try:
        return bool(open_capture(folder))
    except (UserError, OSError):
        return False


def _listed(path: Path) -> list[Path]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise UserError(path, "cannot be read as a list of captures", "write a text file with a path a line") from error
    kept = [line.strip() for line in lines if line.strip() and not line.strip().startswith("#")]
    if not kept:
        raise UserError(path, "names no capture", "write a path a line")
    return [Path(os.path.normpath(path.parent / line)) for line in kept]


def _named(captures: list[Path], root: Path) -> list[Place]:
    """Each with the name of its folder, and as many of the folders above as tell it from others."""
    twice = [path for path, count in Counter(map(os.path.realpath, captures)).items() if count > 1]
    if twice:
        raise UserError(root, f"{twice[0]} is named twice", "name every capture once")
    depth = dict.fromkeys(captures, 1)
    while True:
        names = {path: "_".join(path.absolute().parts[-depth[path] :]) for path in captures}
        count = Counter(name.casefold() for name in names.values())
        same = [p for p in captures if count[names[p].casefold()] > 1 and depth[p] < len(p.absolute().parts)]
        if not same:
            break
        for path in same:
            depth[path] += 1
    for path, name in names.items():
        if fault := fault_of_name(name):
            raise UserError(path, f"its name {fault}, and its dataset is named after it", "rename the folder")
    return [Place(names[path], path) for path in captures]
