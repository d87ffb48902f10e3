"""Where a light stage's frames lie: in the capture, or in decode's folder where they had to be made linear first."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

IN_DECODE = "decode"
"""What olat.json says under "frames_in" where its paths are relative to its own folder; without it they are the capture's."""


def frames_root(index: Mapping[str, Any], capture_root: Path, decode_folder: Path) -> Path:
    """Find the folder that the paths under "cross" and "parallel" in olat.json are relative to.

    Args:
        index: olat.json's content.
        capture_root: the capture's folder.
        decode_folder: where olat.json lies.

    Returns:
        `decode_folder` where decode made the frames linear, else `capture_root`.
    """
    return decode_folder if index.get("frames_in") == IN_DECODE else capture_root
