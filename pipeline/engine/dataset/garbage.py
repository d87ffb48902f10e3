"""Which versions of a dataset can go: those that nothing in use was made from."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pipeline.engine.dataset.directory import Dataset
from pipeline.formats.dataset_files import MANIFEST

KEY = re.compile(r"[0-9a-f]{16}")


@dataclass(frozen=True)
class Garbage:
    """A folder that can go: its size, and what it is in words."""

    folder: Path
    bytes: int
    what: str


def garbage(dataset: Dataset, stages: Iterable[str]) -> list[Garbage]:
    """Versions that are neither in use nor an input, however far upstream, of one in use; and unfinished work.

    Only folders named after a key inside those named after a stage are looked at: a dataset beside other things, or
    with notes in it, keeps them.
    """
    stages = list(stages)
    kept = _in_use_and_upstream(dataset, stages)
    out = []
    for stage in stages:
        for folder in _folders(dataset.root / stage):
            if (stage, folder.name) not in kept:
                out.append(Garbage(folder, size_of(folder), f"{stage}, not in use"))
        for folder in _folders(dataset.root / ".work" / stage):
            out.append(Garbage(folder, size_of(folder), f"{stage}, unfinished"))
    return out


def remove(items: Iterable[Garbage]) -> None:
    """Delete the folders."""
    for item in items:
        shutil.rmtree(item.folder)


def size_of(folder: Path) -> int:
    """Bytes of all files below a folder."""
    return sum(p.lstat().st_size for p in folder.rglob("*") if not p.is_dir())


def _folders(parent: Path) -> list[Path]:
    found = parent.iterdir() if parent.is_dir() else ()
    return sorted(p for p in found if KEY.fullmatch(p.name) and p.is_dir() and not p.is_symlink())


def _in_use_and_upstream(dataset: Dataset, stages: Iterable[str]) -> set[tuple[str, str]]:
    links = [(stage, dataset.root / stage / "current") for stage in stages]
    queue = [(stage, os.readlink(link)) for stage, link in links if link.is_symlink()]  # a damaged one is in use too
    kept: set[tuple[str, str]] = set()
    while queue:
        stage, key = queue.pop()
        if (stage, key) not in kept:
            kept.add((stage, key))
            queue += _made_from(dataset.root / stage / key)
    return kept


def _made_from(folder: Path) -> list[tuple[str, str]]:
    try:
        manifest = json.loads((folder / MANIFEST).read_text())
    except (OSError, ValueError):
        return []
    return list(manifest.get("inputs", {}).get("stages", {}).items())
