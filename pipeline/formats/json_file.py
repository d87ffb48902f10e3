"""JSON of strangers: whatever is wrong with a file is one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pipeline.errors import UserError

LARGEST = 1 << 28
"""Bytes; ten thousand frames are 10 MB."""


def read_json(path: Path, remedy: str = "export it again") -> Any:
    """Read a JSON file of anybody's.

    Args:
        path: the file.
        remedy: what to do about a broken one, for the error.

    Returns:
        What it holds.

    Raises:
        UserError: it is no regular file, missing, larger than `LARGEST`, no JSON, or nested past all sense.
    """
    if path.exists() and not path.is_file():
        raise UserError(path, "is not a regular file", remedy)
    try:
        if path.stat().st_size > LARGEST:
            raise UserError(path, f"is larger than {LARGEST >> 20} MB", remedy)
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except RecursionError:
        raise UserError(path, "is not valid JSON (nested too deeply)", remedy) from None
    except (OSError, ValueError) as error:
        raise UserError(path, f"is not valid JSON ({error})", remedy) from None
