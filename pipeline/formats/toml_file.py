"""TOML of strangers: whatever is wrong with a file is one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pipeline.errors import UserError

LARGEST = 1 << 24
"""Bytes; a thousand cameras' settings are 0.1 MB."""


def read_toml(path: Path, remedy: str) -> dict[str, Any]:
    """Read a TOML file of anybody's.

    Args:
        path: the file.
        remedy: what to do about a broken one, for the error.

    Returns:
        Its table.

    Raises:
        UserError: it is no regular file, cannot be read, is larger than `LARGEST`, no TOML, or nested past all sense.
    """
    if path.exists() and not path.is_file():
        raise UserError(path, "is not a regular file", remedy)
    try:
        if path.stat().st_size > LARGEST:
            raise UserError(path, f"is larger than {LARGEST >> 20} MB", remedy)
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, ValueError, OSError) as error:
        raise UserError(path, f"is not valid TOML: {error}", remedy) from None
    except RecursionError:
        raise UserError(path, "is not valid TOML: nested too deeply", remedy) from None
