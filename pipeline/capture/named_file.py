"""Files that a stage's parameters name."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import UserError

from .model import Capture


def named_file(capture: Capture, name: str, key: str) -> Path | None:
    """The file that a parameter names: in the capture's folder, else where the command runs.

    Args:
        capture: whose folder is looked in.
        name: the parameter's value; empty: no file is meant.
        key: the parameter, for the message.

    Returns:
        Its path; None where none is meant.

    Raises:
        UserError: there is no such file.
    """
    if not name:
        return None
    for path in (capture.root / name, Path(name)):
        if path.is_file():
            return path
    raise UserError(name, "no such file, in the capture's folder or here", f"check {key}=")
