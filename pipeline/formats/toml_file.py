"""TOML of strangers: whatever is wrong with a file is one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pipeline.errors import UserError


def read_toml(path: Path, remedy: str) -> dict[str, Any]:
    """Read a TOML file of anybody's.

    Args:
        path: the file.
        remedy: what to do about a broken one, for the error.

    Returns:
        Its table.

    Raises:
        UserError: it cannot be read, is no TOML, or is nested past all sense.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise UserError(path, f"is not valid TOML: {error}", remedy) from None
    except RecursionError:
        raise UserError(path, "is not valid TOML: nested too deeply", remedy) from None
