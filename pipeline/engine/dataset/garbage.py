"""Which versions of a dataset can go: those that nothing in use was made from. What cannot be judged stays."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pipeline.engine.dataset.directory import Dataset
from pipeline.engine.dataset.links import refuse_links
from pipeline.engine.dataset.versions import KEY


@dataclass(frozen=True)
class Garbage:
    """A folder that can go: its size, and what it is in words."""

    folder: Path
    bytes: int
    what: str


@dataclass(frozen=True)
class Collection:
    """What can go, and why other versions that may not be needed stay."""

    items: list[Garbage]
    doubts: list[str]


def collection(dataset: Dataset, stages: Iterable[str]) -> Collection:
    """Versions that are neither in use nor an input, however far upstream, of one in use; and unfinished work.

    Only folders named after a key inside those named after a stage are looked at: a dataset beside other things, or
    with notes in it, keeps them. A stage of which nothing tells the version in use keeps all, and so does every stage
    before a version in use whose manifest cannot be read. Raises UserError where a stage's folder is a link.
    """
    stages = list(stages)
    for stage in stages:
        refuse_links(dataset.root, dataset.root / stage)
        refuse_links(dataset.root, dataset.root / ".work" / stage)
    kept, doubts = _in_use_and_upstream(dataset, stages)
    items = []
    for stage in stages:
        for folder in _folders(dataset.root / stage):
            if (stage, folder.name) not in kept:
                items.append(Garbage(folder, size_of(folder), f"{stage}, not in use"))
        for folder in _folders(dataset.root / ".work" / stage):
            items.append(Garbage(folder, size_of(folder), f"{stage}, unfinished"))
    return Collection(items, doubts)


def remove(items: Iterable[Garbage]) -> None:
    """Delete the folders, and the locks of what was unfinished."""
    for item in items:
        shutil.rmtree(item.folder)
        with contextlib.suppress(FileNotFoundError):
            item.folder.with_name(f"{item.folder.name}.lock").unlink()


def size_of(folder: Path) -> int:
    """Bytes of all files below a folder."""
    return sum(p.lstat().st_size for p in folder.rglob("*") if not p.is_dir())


def _folders(parent: Path) -> list[Path]:
    found = parent.iterdir() if parent.is_dir() else ()
    return sorted(p for p in found if KEY.fullmatch(p.name) and p.is_dir() and not p.is_symlink())


def _in_use_and_upstream(dataset: Dataset, stages: list[str]) -> tuple[set[tuple[str, str]], list[str]]:
    """The versions (stage, key) to keep, and what could not be judged."""
    doubts: list[str] = []
    queue: list[tuple[str, str]] = []
    whole: set[str] = set()  # stages of which every version stays
    for stage in stages:
        there = {p.name for p in _folders(dataset.root / stage)}
        used = [key for key in dataset.in_use_table.keys(stage) if key in there]
        queue += [(stage, key) for key in used]  # a damaged one is in use too
        if there and not used:
            whole.add(stage)
            doubts.append(f"{dataset.root / stage}: nothing tells which version is in use, so all stay; `make all` tells it")
    kept: set[tuple[str, str]] = set()
    while True:
        queue += [(s, p.name) for s in whole for p in _folders(dataset.root / s)]
        queue = [item for item in queue if item not in kept]
        if not queue:
            return kept, doubts
        for stage, key in queue:
            kept.add((stage, key))
        queue, read = [], queue
        for stage, key in read:
            version = dataset.read(stage, key)
            if version is not None:
                queue += version.made_from.items()
            elif before := {s for s in stages[: stages.index(stage)] if s not in whole} if stage in stages else set():
                whole |= before
                doubts.append(
                    f"{dataset.root / stage / key}: its manifest cannot be read, so every version of "
                    f"{', '.join(sorted(before))} stays; `make verify REPAIR=1` drops what is damaged"
                )
