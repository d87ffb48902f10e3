"""Checkpoints in the stage's scratch folder: everything that the next step depends on, written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import torch

NAME = "checkpoint.pt"
SCHEMA = 2  # of the saved state; one of another schema is as none


def save(folder: Path, state: dict[str, Any]) -> None:
    """Write the state aside, sync, rename."""
    folder.mkdir(parents=True, exist_ok=True)
    aside = folder / (NAME + ".new")
    with aside.open("wb") as file:
        torch.save({"schema": SCHEMA} | state, file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(aside, folder / NAME)


def load(folder: Path) -> dict[str, Any] | None:
    """The last state saved, or None where there is none (or none that can be read: training then starts afresh)."""
    path = folder / NAME
    if not path.is_file():
        return None
    try:
        state = torch.load(path, weights_only=True)
    except (RuntimeError, EOFError, OSError, ValueError, KeyError):
        return None
    return state if state.pop("schema", None) == SCHEMA else None


def clear(folder: Path) -> None:
    """Remove the checkpoint: its run has ended."""
    (folder / NAME).unlink(missing_ok=True)
