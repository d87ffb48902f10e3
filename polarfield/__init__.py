"""Datasets as numpy arrays: `polarfield.open(folder)` (docs/python.md)."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import UserError

from .results import Results

__all__ = ["Results", "UserError", "open"]


def open(folder: str | Path) -> Results:
    """The results in use of a dataset directory, each read when it is asked for. Raises UserError where there is no dataset."""
    return Results(Path(folder))
