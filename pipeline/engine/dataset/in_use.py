"""Which version of each stage is in use: recorded by DATASET/in_use.json and by the links STAGE/current, either of them enough.

Links are lost by zip, by clouds, on FAT and SMB, and become folders by `cp -rL` or `rsync -rL`; the file survives these.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
from pathlib import Path

from pipeline.engine.dataset.documents import aside_of, read_object, sync, write_whole
from pipeline.engine.dataset.links import refuse_links
from pipeline.engine.dataset.locks import open_lock
from pipeline.engine.dataset.versions import KEY, is_whole, read_version
from pipeline.formats.dataset_files import MANIFEST

FILE, LINK = "in_use.json", "current"
SCHEMA = 1
NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO)


class InUse:
    """What is in use in the dataset at `root`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.path = root / FILE

    def recorded(self) -> dict[str, str]:
        """What in_use.json records: stage to key; nothing where it is missing or damaged."""
        table = read_object(self.path) or {}
        return {k: v for k, v in table.items() if isinstance(v, str) and KEY.fullmatch(v)}

    def linked(self, stage: str) -> str | None:
        """The key that STAGE/current tells: a link, a folder that was copied in its place, or a file that holds its text."""
        link = self.root / stage / LINK
        try:
            if link.is_symlink():
                key = os.readlink(link)
            elif link.is_dir():
                key = str((read_object(link / MANIFEST) or {}).get("key", ""))
            elif link.is_file() and link.stat().st_size < 256:
                key = link.read_text().strip()
            else:
                return None
        except (OSError, ValueError):
            return None
        return key if KEY.fullmatch(key) else None

    def keys(self, stage: str) -> list[str]:
        """Every key that either tells, the file's first: it is written first."""
        return list(dict.fromkeys(k for k in (self.recorded().get(stage), self.linked(stage)) if k))

    def put(self, stage: str, key: str) -> None:
        """Put a version to use: the file, then the link, each at once. Where links cannot be, the file tells it alone."""
        if self.recorded().get(stage) != key:
            with open_lock(self.root / ".work" / "in_use_file.lock") as lock:
                lock.take(alone=True)
                links = {p.name: k for p in self.root.iterdir() if p.is_dir() and (k := self.linked(p.name))}
                table = {"schema": SCHEMA, **dict(sorted({**links, **self.recorded(), stage: key}.items()))}
                write_whole(self.path, in_use_text(table))
        link = self.root / stage / LINK
        if link.is_symlink() and os.readlink(link) == key:
            return
        refuse_links(self.root, link.parent)
        aside = aside_of(link)
        try:
            aside.symlink_to(key)
        except OSError as error:
            if error.errno in NO_SPACE:
                raise
            _make_way(link, stage)  # what lies there tells of an earlier version
            return
        if link.exists() and not link.is_symlink():
            _make_way(link, stage)
        aside.replace(link)
        sync(link.parent)

    def adopt(self, stage: str) -> None:
        """Let a whole version that was copied to STAGE/current, without STAGE/KEY, be STAGE/KEY again."""
        copied, key = self.root / stage / LINK, self.linked(stage)
        if key is None or copied.is_symlink() or not copied.is_dir() or (self.root / stage / key).exists():
            return
        version = read_version(stage, key, copied)
        if version is not None and is_whole(version):
            refuse_links(self.root, copied)
            copied.rename(copied.with_name(key))


def in_use_text(table: dict) -> str:
    """in_use.json as it is written."""
    return json.dumps(table, indent=1) + "\n"


def _make_way(place: Path, stage: str) -> None:
    """Remove what lies where the link belongs, if it is a link or a copy of a version that is there; else keep it beside."""
    if place.is_symlink() or not place.exists():
        with contextlib.suppress(FileNotFoundError):
            place.unlink()
    elif place.is_file() and place.stat().st_size < 256 and KEY.fullmatch(place.read_text(errors="replace").strip()):
        place.unlink()
    elif place.is_dir() and _is_a_copy(place, stage):
        gone = aside_of(place)
        place.rename(gone)
        shutil.rmtree(gone)
    else:
        number = next(n for n in range(1, 1 << 20) if not place.with_name(f"{LINK}-kept-{n}").exists())
        place.rename(place.with_name(f"{LINK}-kept-{number}"))


def _is_a_copy(folder: Path, stage: str) -> bool:
    """Whether a folder holds the files of a version that lies beside it, and nothing else."""
    key = str((read_object(folder / MANIFEST) or {}).get("key", ""))
    version = read_version(stage, key, folder) if KEY.fullmatch(key) else None
    there = read_version(stage, key, folder.with_name(key)) if version else None
    if version is None or there is None or not is_whole(there):
        return False
    files = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if not p.is_dir()}
    return files <= {MANIFEST, *(o["path"] for o in version.manifest["outputs"])}
