"""Where versions live, how they are made, found, published and put to use."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from pipeline.engine.dataset import description
from pipeline.engine.dataset.digests import DigestCache
from pipeline.engine.dataset.documents import sealed, sync, write_whole
from pipeline.engine.dataset.in_use import LINK, InUse
from pipeline.engine.dataset.leftovers import clear_leftovers
from pipeline.engine.dataset.links import holds_what_no_run_leaves, refuse_links
from pipeline.engine.dataset.locks import open_lock
from pipeline.engine.dataset.presence import present
from pipeline.engine.dataset.versions import KEY, Version, is_whole, read_version
from pipeline.errors import UserError
from pipeline.formats.dataset_files import MANIFEST

SYNCED = 8  # files at once


class Dataset:
    """A dataset directory.

    Layout: `STAGE/KEY/` immutable versions, `in_use.json` and the relative links `STAGE/current` tell those in use,
    `dataset.json`. What is being made lies under `.work/STAGE/KEY/` (`output` becomes the version, `scratch` holds
    checkpoints).
    """

    def __init__(self, root: Path) -> None:
        """Look at a dataset directory, which need not exist.

        Args:
            root: the directory.
        """
        self.root = root
        self.digests = DigestCache(root / ".work" / "digests.json")
        self.in_use_table = InUse(root)

    @classmethod
    def holding(cls, version: Path) -> Dataset:
        """The dataset that a version's folder (or a stage's `current`) lies in."""
        return cls(Path(os.path.abspath(version)).parents[1])

    # -- finding ---------------------------------------------------------------------------------------------------

    def read(self, stage: str, key: str) -> Version | None:
        """The version of that key if its manifest can be read, whole or not; one copied to STAGE/current counts."""
        folder = self.root / stage / key
        if not folder.exists() and not (self.root / stage / LINK).is_symlink():
            folder = self.root / stage / LINK
        return read_version(stage, key, folder)

    def find(self, stage: str, key: str) -> Version | None:
        """The published version of that key, or None; a version with a missing or short file counts as none."""
        version = self.read(stage, key)
        return version if version is not None and is_whole(version) else None

    def current(self, stage: str) -> Version | None:
        """The version in use, or None."""
        return next((v for v in (self.find(stage, key) for key in self.in_use_table.keys(stage)) if v), None)

    def versions(self, stage: str) -> list[Version]:
        """All whole versions of a stage."""
        folder = self.root / stage
        keys = sorted(p.name for p in folder.iterdir() if KEY.fullmatch(p.name)) if folder.is_dir() else []
        return [v for v in (self.find(stage, key) for key in keys) if v]

    def place(self, version: Version) -> Path:
        """Where a person finds a version: STAGE/current where that is a link to it, else its own folder."""
        link = self.root / version.stage / LINK
        return link if link.is_symlink() and os.readlink(link) == version.key else version.folder

    def work_folder(self, stage: str, key: str) -> Path:
        """Where a version is made; it outlives a kill."""
        return self.root / ".work" / stage / key

    @property
    def exists(self) -> bool:
        """Whether the folder is a dataset: it has a description, tells what is in use, or work was begun in it."""
        return any((self.root / name).is_file() for name in (description.FILE, "in_use.json")) or (self.root / ".work").is_dir()

    def read_description(self) -> dict[str, Any]:
        """`dataset.json`, or an empty dict where there is none."""
        return description.read_description(self.root)

    # -- writing ---------------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Make the directory, or say in one line why that cannot be."""
        probe = self.root / ".work" / f"probe-{os.getpid()}"
        try:
            new = [p for p in (probe.parent, *probe.parent.parents) if not p.exists()]
            probe.parent.mkdir(parents=True, exist_ok=True)
            for folder in new:  # what is published must not lose its way from the root of the disk
                sync(folder.parent)
            refuse_links(self.root, probe.parent)
            write_whole(probe, "\0" * 4096)
            probe.unlink(missing_ok=True)
        except OSError as error:
            with contextlib.suppress(OSError):
                probe.unlink()
            raise UserError(self.root, f"cannot write the dataset ({error.strerror})", "choose another DATASET=") from error

    def write_text(self, path: Path, text: str) -> None:
        """Write a small file whole: aside, synced, renamed. Leaves an equal file untouched."""
        write_whole(path, text)

    def describe(self, facts: Mapping[str, Any]) -> None:
        """Write `dataset.json`."""
        description.write_description(self.root, facts)

    def use(self, version: Version) -> None:
        """Put a version to use: in_use.json and `STAGE/current` name it."""
        self.in_use_table.put(version.stage, version.key)

    @contextlib.contextmanager
    def in_use(self, alone: bool = False) -> Iterator[bool]:
        """Hold the dataset open for a run; `alone` asks to be the only one. Yields whether that was granted.

        Who is the first to come clears what killed runs left, and lets versions that were copied to STAGE/current be found.
        Raises UserError where a run on another machine is at work whose locks do not reach here.
        """
        with present(self.root), open_lock(self.root / ".work" / "in_use.lock") as lock:
            first = lock.try_to_take(alone=True)
            if first:
                clear_leftovers(self.root, self.find)
                for folder in self.root.iterdir():
                    if folder.is_dir() and not folder.is_symlink():
                        self.in_use_table.adopt(folder.name)
            if not alone:
                lock.take(alone=False)  # a collection is soon over
            yield first or not alone

    @contextlib.contextmanager
    def making(self, stage: str, key: str, waiting: Callable[[], None]) -> Iterator[Path]:
        """Hold the right to make one version; yields its work folder.

        Another process that makes the same version is waited for (after calling `waiting`); a killed one lets go by
        dying. Different keys do not wait for each other. Work that holds links, which no run leaves, is begun anew.
        """
        work = self.work_folder(stage, key)
        refuse_links(self.root, work.parent)
        work.parent.mkdir(parents=True, exist_ok=True)
        with open_lock(work.parent / f"{key}.lock") as lock:
            lock.take(alone=True, waiting=waiting)
            refuse_links(self.root, work)
            if work.exists() and (not work.is_dir() or holds_what_no_run_leaves(work)):
                _remove(work)
            work.mkdir(parents=True, exist_ok=True)
            yield work

    def publish(self, stage: str, key: str, output: Path, manifest: Mapping[str, Any]) -> Version:
        """Make `output` the version `stage/key`: manifest added, everything synced, one rename."""
        refuse_links(self.root, self.root / stage)
        write_whole(output / MANIFEST, sealed(dict(manifest)))
        with ThreadPoolExecutor(SYNCED) as pool:  # a disk takes several at once for one
            for folder, _, names in os.walk(output):
                list(pool.map(sync, [Path(folder) / name for name in names]))
                sync(Path(folder))
        target = self.root / stage / key
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() or target.is_symlink():  # a damaged version, or `find` would have returned it
            _remove(target)
        output.rename(target)
        sync(target.parent)
        return Version(stage, key, target, manifest)

    def clear_work(self, stage: str, key: str) -> None:
        """Drop the work folder of a version that has been published."""
        shutil.rmtree(self.work_folder(stage, key), ignore_errors=True)


def _remove(path: Path) -> None:
    """Remove a folder; of a link or a file that alone."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
