"""Small JSON files of a dataset: read whatever they hold, sealed so that a flipped bit shows, written whole."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import secrets
from pathlib import Path
from typing import Any

LARGEST = 1 << 28  # bytes; a manifest of a hundred thousand files is 15 MB
BLANK = "0" * 32
SEAL = re.compile(rb'"[^"]*": "([^"]{32})"\n?\}\n?$')  # whatever a flipped bit made of the last key and its value


def read_object(path: Path) -> dict[str, Any] | None:
    """The JSON object that a regular file holds, None where there is none: no file, no JSON, nested past all sense, a list."""
    content = small_file(path)
    try:
        value = None if content is None else json.loads(content)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def small_file(path: Path) -> bytes | None:
    """What a regular file holds; None where there is none, or one larger than `LARGEST`; devices and pipes never end."""
    try:
        return path.read_bytes() if path.is_file() and path.stat().st_size <= LARGEST else None
    except (OSError, ValueError):
        return None


def sealed(value: dict[str, Any], indent: int | None = 1) -> str:
    """The text of a JSON object with a last key `seal`: the BLAKE2b-128 of the text with zeros in its place."""
    text = json.dumps({**{k: v for k, v in value.items() if k != "seal"}, "seal": BLANK}, indent=indent) + "\n"
    before, _, after = text.rpartition(BLANK)
    return before + _digest(text.encode()) + after


def seal_fits(path: Path) -> bool | None:
    """Whether a file's seal is that of its bytes; None where it has no seal (an older program wrote it) or cannot be read."""
    content = small_file(path)
    found = None if content is None else SEAL.search(content)
    if content is None or found is None:
        return None
    return found[1] == _digest(content[: found.start(1)] + BLANK.encode() + content[found.end(1) :]).encode()


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def write_whole(path: Path, text: str) -> None:
    """Write a small file whole: aside, synced, renamed. Leaves an equal file untouched, follows no link."""
    if not path.is_symlink() and small_file(path) == text.encode():
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = aside_of(path)
    try:
        handle = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        with open(handle, "w") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        aside.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise
    sync(path.parent)


def aside_of(path: Path) -> Path:
    """Where a file is written before it takes its place: no process anywhere has that name; the writer's number ends it."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.{os.getpid()}")


def sync(path: Path) -> None:
    """Have a file, or a folder's entries, on the disk."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
