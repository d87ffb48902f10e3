"""What of a dataset is damaged: every file of the versions in use, and of those they were made from, against its digest."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from pipeline.engine.dataset import description, verified
from pipeline.engine.dataset.digests import digest_file
from pipeline.engine.dataset.directory import Dataset
from pipeline.engine.dataset.documents import read_object, seal_fits, small_file
from pipeline.engine.dataset.in_use import LINK, in_use_text
from pipeline.engine.dataset.verified import Verified
from pipeline.engine.dataset.versions import Version, content_key
from pipeline.errors import UserError
from pipeline.formats.dataset_files import MANIFEST

READERS = 4


@dataclass(frozen=True)
class Damage:
    """A file that is not what was written, why, and what goes with it when it is repaired: a version's folder, or the file."""

    file: Path
    fault: str
    drop: Path


def versions_in_use(dataset: Dataset, stages: Iterable[str]) -> tuple[list[Version], list[Damage]]:
    """The versions in use and all upstream of them, and those whose manifest is missing or damaged."""
    queue = [(stage, key) for stage in stages for key in dataset.in_use_table.keys(stage)]
    seen: set[tuple[str, str]] = set()
    found, bad = [], []
    while queue:
        stage, key = queue.pop(0)
        if (stage, key) in seen:
            continue
        seen.add((stage, key))
        version = dataset.read(stage, key)
        if version is not None and content_key(version.manifest) == key and seal_fits(version.folder / MANIFEST) is not False:
            found.append(version)
            queue += version.made_from.items()
            continue
        folder = dataset.root / stage / key
        fault = "is missing" if not (folder / MANIFEST).exists() else "is not what was written"
        bad.append(Damage(folder / MANIFEST, fault, folder))
    return found, bad


def damaged_files(
    dataset: Dataset, versions: Iterable[Version], known: Verified | None, read: Callable[[int], None] | None = None
) -> Iterator[Damage]:
    """Files of these versions that are missing or not what was written; those that `known` vouches for are not read."""
    unread = []
    for version in versions:
        for output in version.manifest["outputs"]:
            path = version.folder / output["path"]
            name = f"{version.stage}/{version.key}/{output['path']}"
            try:
                found = os.stat(path)
            except (OSError, ValueError):
                yield Damage(path, "is missing", version.folder)
                continue
            stat = (found.st_size, found.st_mtime_ns)
            if not path.is_file() or found.st_size != output["bytes"]:
                yield Damage(path, f"has {found.st_size} bytes, not {output['bytes']}", version.folder)
            elif known is not None and known.knows(name, stat, output["digest"]):
                if read is not None:
                    read(found.st_size)
            else:
                unread.append((path, name, stat, output["digest"], version))

    def digest(path: Path) -> str:
        try:
            return digest_file(path, read)
        except UserError as error:
            return error.fault

    with ThreadPoolExecutor(READERS) as pool:
        try:
            for (path, name, stat, want, version), have in zip(unread, pool.map(digest, [u[0] for u in unread])):
                if have != want:
                    yield Damage(path, "is not what was written" if len(have) == len(want) else have, version.folder)
                elif known is not None:
                    known.add(name, stat, want)
        finally:
            pool.shutdown(cancel_futures=True)


def damaged_records(dataset: Dataset, stages: Iterable[str]) -> Iterator[Damage]:
    """The dataset's own small files: dataset.json, in_use.json, the links, and what is remembered of digests."""
    root, stages = dataset.root, list(stages)
    path = root / description.FILE
    if not path.exists():
        yield Damage(path, "is missing", path)
    elif seal_fits(path) is False or description.read_description(root).get("capture") is None:
        yield Damage(path, "is not what was written", path)
    for path in (description.kept_copy(root), dataset.digests.path, root / ".work" / verified.FILE):
        if path.exists() and not seal_fits(path):
            yield Damage(path, "is not what was written", path)
    yield from _damaged_in_use(dataset, stages)


def _damaged_in_use(dataset: Dataset, stages: list[str]) -> Iterator[Damage]:
    """in_use.json, and links, that contradict each other or name what is not there."""
    recorded, path = dataset.in_use_table.recorded(), dataset.in_use_table.path
    wrong = []
    if path.exists():
        text = (small_file(path) or b"").decode(errors="replace")
        if text != in_use_text(read_object(path) or {}) or set(read_object(path) or {}) - {"schema", *stages}:
            wrong.append("is not what was written")
        for stage in stages:
            linked = dataset.in_use_table.linked(stage)
            here = [key for key in (recorded.get(stage), linked) if key and dataset.read(stage, key)]
            link = dataset.root / stage / LINK
            if recorded.get(stage) != linked and here:
                if here == [linked]:
                    wrong.append(f"tells of no version of {stage} that is there")
                elif link.is_symlink():
                    yield Damage(link, f"names {os.readlink(link)}, and {path.name} {recorded[stage]}", link)
    if wrong:
        yield Damage(path, wrong[0], path)
