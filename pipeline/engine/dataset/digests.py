"""Content digests of files and of JSON values; files are read once and then known by size and modification time."""

from __future__ import annotations

import hashlib
import json
import stat
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from pipeline.engine.dataset.documents import read_object, seal_fits, sealed
from pipeline.errors import UserError

CHUNK = 1 << 20
SCHEMA = 2


def digest_file(path: Path, read: Callable[[int], None] | None = None) -> str:
    """BLAKE2b-128 of a file's bytes, hexadecimal; `read` is told of each piece's size. Raises UserError."""
    state = hashlib.blake2b(digest_size=16)
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(CHUNK):
                state.update(chunk)
                if read is not None:
                    read(len(chunk))
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the file and its permissions") from error
    return state.hexdigest()


def digest_json(value: Any) -> str:
    """BLAKE2b-128 of a JSON value in canonical form, hexadecimal."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


class DigestCache:
    """File digests remembered in a sealed JSON file, by absolute path, size and modification time; none if it is damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.changed = False
        self.seen: dict[Path, tuple[int, ...]] = {}
        self.known: dict[str, list] = {}
        table = read_object(path) or {}
        if table.get("schema") == SCHEMA and seal_fits(path) and isinstance(table.get("files"), dict):
            self.known = {k: v for k, v in table["files"].items() if isinstance(v, list) and len(v) == 3}

    def digests(self, root: Path, files: Iterable[Path]) -> dict[str, str]:
        """Digest of each file, by its path below `root` (or its name, outside of it). Raises UserError."""
        files = sorted({f.absolute() for f in files})
        stats = {f: _stat(f) for f in files}
        self.seen.update(stats)
        new = [f for f in files if self.known.get(str(f), [])[:2] != list(stats[f][:2])]
        if new:
            with ThreadPoolExecutor(4) as pool:
                for f, digest in zip(new, pool.map(digest_file, new)):
                    self.known[str(f)] = [*stats[f][:2], digest]
            self.changed = True
        root = root.absolute()
        return {(f.relative_to(root).as_posix() if f.is_relative_to(root) else f.name): self.known[str(f)][2] for f in files}

    def altered(self, files: Iterable[Path]) -> Path | None:
        """The first of these files whose content is another than `digests` found, or None.

        A file that was not touched since (size, times and number on the disk) is not read again. Raises UserError.
        """
        for f in (f.absolute() for f in files):
            now = _stat(f)
            if now != self.seen.get(f, now) and digest_file(f) != self.known[str(f)][2]:
                return f
        return None

    def take(self, other: DigestCache) -> None:
        """Know what another cache knows, too."""
        new = {name: facts for name, facts in other.known.items() if self.known.get(name) != facts}
        self.known |= new
        self.changed |= bool(new)

    def save(self, write: Callable[[Path, str], None]) -> None:
        """Keep what was learnt, through the given atomic writer."""
        if self.changed:
            write(self.path, sealed({"schema": SCHEMA, "files": self.known}, indent=None))
            self.changed = False


def _stat(path: Path) -> tuple[int, ...]:
    """Size, modification time, change time and number of a regular file. Raises UserError."""
    try:
        found = path.stat()
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the file and its permissions") from error
    if not stat.S_ISREG(found.st_mode):
        raise UserError(path, "is not a regular file", "remove it, or put the file itself there")
    return found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino
