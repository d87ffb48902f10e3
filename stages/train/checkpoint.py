"""Checkpoints in the stage's scratch folder: everything that the next step depends on, written whole or not at all."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

NAME = "checkpoint.pt"
DIGEST_BYTES = 16  # before the state: a damaged state may still load
SCHEMA = 3  # of the saved state; one of another schema is as none


def save(folder: Path, state: dict[str, Any]) -> None:
    """Write the state aside, sync, rename. Raises OSError, and leaves nothing, where that cannot be (a full disk)."""
    write(folder, pack(state))


def pack(state: dict[str, Any]) -> bytes:
    """The state as it is written: a BLAKE2b-128, then what torch writes."""
    stream = io.BytesIO()
    torch.save({"schema": SCHEMA} | state, stream)
    content = stream.getvalue()
    return _digest(content) + content


def write(folder: Path, packed: bytes) -> None:
    """`save` of a packed state."""
    folder.mkdir(parents=True, exist_ok=True)
    aside = folder / (NAME + ".new")
    try:
        with aside.open("wb") as file:
            file.write(packed)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, folder / NAME)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise


def load(folder: Path, say: Callable[[str], None] | None = None, device: str = "cpu") -> dict[str, Any] | None:
    """The last state saved, on a device; None where there is none, or a damaged one: `say` tells, training starts afresh."""
    path = folder / NAME
    (folder / (NAME + ".new")).unlink(missing_ok=True)
    if not path.is_file():
        return None
    content = path.read_bytes()
    if content[:DIGEST_BYTES] != _digest(content[DIGEST_BYTES:]):
        if say is not None:
            say(f"warning: {path}: is damaged, so that training starts afresh; check the disk")
        path.unlink()
        return None
    state = torch.load(io.BytesIO(content[DIGEST_BYTES:]), map_location=device, weights_only=True)
    return state if state.pop("schema", None) == SCHEMA else None


def clear(folder: Path) -> None:
    """Remove the checkpoint: its run has ended."""
    (folder / NAME).unlink(missing_ok=True)


def _digest(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).digest()
