"""Settings that are not read because of their file's name or place: capture.toml.txt, Capture.toml, images/capture.toml."""

from __future__ import annotations

import difflib
from dataclasses import fields
from pathlib import Path

from pipeline.capture.config import CaptureConfig
from pipeline.capture.naming.files import subfolders
from pipeline.errors import UserError
from pipeline.formats.bare_arrays import SETTINGS_FILE
from pipeline.formats.toml_file import read_toml

KINDS = frozenset({".toml", ".tml", ".txt", ".yaml", ".yml", ".json", ".ini", ".cfg"})
"""Endings of files that hold settings; editors of Windows add .txt and hide it."""
ALIKE = 0.8
"""Of difflib: captures.toml, capure.toml and capture.yaml are as like, config.toml is not."""


def misnamed_settings(root: Path) -> list[str]:
    """A line where a folder without a capture.toml has settings under another name.

    Args:
        root: the capture's folder.

    Returns:
        The line, or nothing.

    Raises:
        UserError: the name differs in letters' case or an added ending alone, or the file lies one folder down.
    """
    if (root / SETTINGS_FILE).exists():
        return []
    here = [p for p in sorted(root.iterdir()) if p.suffix.lower() in KINDS and not p.name.startswith(".") and p.is_file()]
    for path in here:
        if path.name.lower() == SETTINGS_FILE or path.name.lower() in (f"{SETTINGS_FILE}{kind}" for kind in KINDS):
            raise UserError(path, f"is not read: the settings of a capture are in {SETTINGS_FILE}", "rename it")
    below = next((p / SETTINGS_FILE for p in subfolders(root) if (p / SETTINGS_FILE).is_file()), None)
    if below is not None:
        remedy = f"move it up, or give CAPTURE={below.parent} if that is the capture"
        raise UserError(below, "lies below the capture's folder and is not read", remedy)
    meant = next((p for p in here if _looks_meant(p)), None)
    if meant is None:
        return []
    return [f"{meant}: is not read: the settings of a capture are in {SETTINGS_FILE}; rename it if they are this one's"]


def _looks_meant(path: Path) -> bool:
    """Whether a file is nearly called capture.toml, or is TOML with some of its keys and no others."""
    if difflib.SequenceMatcher(None, path.name.lower(), SETTINGS_FILE).ratio() >= ALIKE:
        return True
    if path.suffix.lower() != ".toml":
        return False
    try:
        keys = set(read_toml(path, ""))
    except UserError:
        return False
    return bool(keys) and keys <= {field.name for field in fields(CaptureConfig)}
