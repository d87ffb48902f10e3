"""Files that a stage's parameters name."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import UserError

from .model import Capture


def named_file(capture: Capture, name: str, key: str) -> Path | None:
    """The file called `name`: in the capture's folder, else where the command runs; None where none is given.

    key: the parameter that names it. Raises UserError.
    """
    if not name:
        return None
    for path in (capture.root / name, Path(name)):
        if path.is_file():
            return path
    raise UserError(name, "no such file, in the capture's folder or here", f"check {key}=")
