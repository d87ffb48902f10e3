"""Which files were read and found whole: by path, size and modification time, so that a check goes on where it ended."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

from pipeline.engine.dataset.documents import read_object, seal_fits, sealed, write_whole
from pipeline.errors import UserError

FILE = "verified.json"
SCHEMA = 1
INTERVAL_S = 5.0  # between two writings: what a killed check reads again


class Verified:
    """Files of a dataset that were found whole; kept in `.work/verified.json` where that can be written."""

    def __init__(self, root: Path, fresh: bool, keep: bool) -> None:
        self.path, self.keep = root / ".work" / FILE, keep
        self.written = time.monotonic()
        self.known: dict[str, list] = {}
        table = read_object(self.path) or {}
        if not fresh and table.get("schema") == SCHEMA and seal_fits(self.path) and isinstance(table.get("files"), dict):
            self.known = table["files"]

    def knows(self, name: str, stat: tuple[int, int], digest: str) -> bool:
        """Whether the file `name` was found to have this digest when it had this size and time."""
        return self.known.get(name) == [*stat, digest]

    def add(self, name: str, stat: tuple[int, int], digest: str) -> None:
        """Remember a file that was found whole."""
        self.known[name] = [*stat, digest]
        if time.monotonic() - self.written > INTERVAL_S:
            self.save()

    def save(self) -> None:
        """Write what is known; a disk that is full or read-only loses it, and nothing else."""
        self.written = time.monotonic()
        if self.keep:
            with contextlib.suppress(OSError, UserError):
                write_whole(self.path, sealed({"schema": SCHEMA, "files": self.known}, indent=None))
