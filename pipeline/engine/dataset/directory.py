"""Where versions live, how they are made, found, published and collected."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.engine.dataset.digests import DigestCache
from pipeline.errors import UserError
from pipeline.formats.dataset_files import MANIFEST

SCHEMA = 1


DESCRIPTION = "dataset.json"


@dataclass(frozen=True)
class Version:
    """One published version of one stage's output."""

    stage: str
    key: str
    folder: Path

    @property
    def manifest(self) -> dict[str, Any]:
        """The manifest that was published with it."""
        return json.loads((self.folder / MANIFEST).read_text())


class Dataset:
    """A dataset directory.

    Layout: `STAGE/KEY/` immutable versions, `STAGE/current` a relative link to the one in use, `dataset.json`. What is
    being made lies under `.work/STAGE/KEY/` (`output` becomes the version, `scratch` holds checkpoints).
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.digests = DigestCache(root / ".work" / "digests.json")

    @classmethod
    def holding(cls, version: Path) -> Dataset:
        """The dataset that a version's folder (or a stage's `current`) lies in."""
        return cls(Path(os.path.abspath(version)).parents[1])

    # -- finding ---------------------------------------------------------------------------------------------------

    def find(self, stage: str, key: str) -> Version | None:
        """The published version of that key, or None; a version with a missing or short file counts as none."""
        folder = self.root / stage / key
        try:
            manifest = json.loads((folder / MANIFEST).read_text())
            whole = all((folder / o["path"]).stat().st_size == o["bytes"] for o in manifest["outputs"])
        except (OSError, ValueError, KeyError):
            return None
        return Version(stage, key, folder) if whole else None

    def current(self, stage: str) -> Version | None:
        """The version that `STAGE/current` points to, or None."""
        link = self.root / stage / "current"
        return self.find(stage, os.readlink(link)) if link.is_symlink() else None

    def versions(self, stage: str) -> list[Version]:
        """All whole versions of a stage."""
        folder = self.root / stage
        keys = sorted(p.name for p in folder.iterdir() if not p.is_symlink()) if folder.is_dir() else []
        return [v for v in (self.find(stage, key) for key in keys) if v]

    def work_folder(self, stage: str, key: str) -> Path:
        """Where a version is made; it outlives a kill."""
        return self.root / ".work" / stage / key

    @property
    def exists(self) -> bool:
        """Whether the folder is a dataset: it has a description, or work was begun in it."""
        return (self.root / DESCRIPTION).is_file() or (self.root / ".work").is_dir()

    def read_description(self) -> dict[str, Any]:
        """`dataset.json`, or an empty dict where there is none."""
        try:
            return json.loads((self.root / DESCRIPTION).read_text())
        except (OSError, ValueError):
            return {}

    # -- writing ---------------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Make the directory, or say in one line why that cannot be."""
        probe = self.root / ".work" / f"probe-{os.getpid()}"
        try:
            probe.parent.mkdir(parents=True, exist_ok=True)
            probe.write_bytes(b"\0" * 4096)
            probe.unlink()
        except OSError as error:
            with contextlib.suppress(OSError):
                probe.unlink()
            raise UserError(self.root, f"cannot write the dataset ({error.strerror})", "choose another DATASET=") from error

    def write_text(self, path: Path, text: str) -> None:
        """Write a small file whole: aside, synced, renamed. Leaves an equal file untouched."""
        with contextlib.suppress(OSError):
            if path.read_text() == text:
                return
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = path.with_name(f".{path.name}.{os.getpid()}")
        with aside.open("w") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        aside.replace(path)

    def describe(self, description: Mapping[str, Any]) -> None:
        """Write `dataset.json`."""
        self.write_text(self.root / DESCRIPTION, json.dumps({"schema": SCHEMA, **description}, indent=1) + "\n")

    def use(self, version: Version) -> None:
        """Point `STAGE/current` at a version, atomically."""
        link = self.root / version.stage / "current"
        if link.is_symlink() and os.readlink(link) == version.key:
            return
        aside = link.with_name(f".current.{os.getpid()}")
        with contextlib.suppress(FileNotFoundError):
            aside.unlink()
        aside.symlink_to(version.key)
        aside.replace(link)
        _sync(link.parent)

    @contextlib.contextmanager
    def in_use(self, alone: bool = False) -> Iterator[bool]:
        """Hold the dataset open for a run; `alone` asks to be the only one. Yields whether that was granted."""
        with (self.root / ".work" / "in_use.lock").open("a") as lock:
            try:
                fcntl.flock(lock, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
            except BlockingIOError:
                if alone:
                    yield False
                    return
                fcntl.flock(lock, fcntl.LOCK_SH)  # a collection is soon over
            yield True

    @contextlib.contextmanager
    def making(self, stage: str, key: str, waiting: Callable[[], None]) -> Iterator[Path]:
        """Hold the right to make one version; yields its work folder.

        Another process that makes the same version is waited for (after calling `waiting`); a killed one lets go by
        dying. Different keys do not wait for each other.
        """
        work = self.work_folder(stage, key)
        work.mkdir(parents=True, exist_ok=True)
        with (work.parent / f"{key}.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                waiting()
                fcntl.flock(lock, fcntl.LOCK_EX)
            work.mkdir(parents=True, exist_ok=True)
            yield work

    def publish(self, stage: str, key: str, output: Path, manifest: Mapping[str, Any]) -> Version:
        """Make `output` the version `stage/key`: manifest added, everything synced, one rename."""
        (output / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
        for folder, _, names in os.walk(output):
            for name in names:
                _sync(Path(folder) / name)
            _sync(Path(folder))
        target = self.root / stage / key
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():  # a damaged version, or `find` would have returned it
            shutil.rmtree(target)
        output.rename(target)
        _sync(target.parent)
        return Version(stage, key, target)

    def clear_work(self, stage: str, key: str) -> None:
        """Drop the work folder of a version that has been published."""
        shutil.rmtree(self.work_folder(stage, key), ignore_errors=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
