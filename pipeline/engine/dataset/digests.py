"""Content digests of files and of JSON values; files are read once and then known by size and modification time."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from pipeline.errors import UserError

CHUNK = 1 << 20


def digest_file(path: Path) -> str:
    """BLAKE2b-128 of a file's bytes, hexadecimal. Raises UserError when it cannot be read."""
    state = hashlib.blake2b(digest_size=16)
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(CHUNK):
                state.update(chunk)
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the file and its permissions") from error
    return state.hexdigest()


def digest_json(value: Any) -> str:
    """BLAKE2b-128 of a JSON value in canonical form, hexadecimal."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


class DigestCache:
    """File digests remembered in a JSON file, by absolute path, size and modification time."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.changed = False
        try:
            self.known: dict[str, list] = json.loads(path.read_text())
        except (OSError, ValueError):
            self.known = {}

    def digests(self, root: Path, files: Iterable[Path]) -> dict[str, str]:
        """Digest of each file, by its path below `root` (or its name, outside of it). Raises UserError."""
        files = sorted({f.absolute() for f in files})
        stats = {f: self._stat(f) for f in files}
        new = [f for f in files if self.known.get(str(f), [])[:2] != stats[f]]
        if new:
            with ThreadPoolExecutor(4) as pool:
                for f, digest in zip(new, pool.map(digest_file, new)):
                    self.known[str(f)] = [*stats[f], digest]
            self.changed = True
        root = root.absolute()
        return {(f.relative_to(root).as_posix() if f.is_relative_to(root) else f.name): self.known[str(f)][2] for f in files}

    @staticmethod
    def _stat(path: Path) -> list[int]:
        try:
            found = path.stat()
        except OSError as error:
            raise UserError(path, f"cannot be read ({error.strerror})", "check the file and its permissions") from error
        return [found.st_size, found.st_mtime_ns]

    def save(self, write: Any) -> None:
        """Keep what was learnt, through the given atomic writer."""
        if self.changed:
            write(self.path, json.dumps(self.known))
            self.changed = False
