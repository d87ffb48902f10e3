"""What killed runs leave: half-written small files, and the work folders of versions that were published."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from pipeline.engine.dataset.versions import KEY

ASIDE = re.compile(
    r"\.(?:dataset\.json|in_use\.json|digests\.json|verified\.json|probe-\d+|current)(?:\.[0-9a-f]{8})?\.(\d+)(?:\.old)?|probe-(\d+)"
)
"""Names of what is written aside; each ends with the number of the process that writes it."""


def clear_leftovers(root: Path, find: Callable[[str, str], object]) -> None:
    """Remove them from the dataset at `root`, where no other run may be at work; `find` tells whether a version is whole."""
    folders = [p for p in root.iterdir() if p.is_dir() and not p.is_symlink()]
    for folder in (root, *folders):
        for path in folder.iterdir():
            found = ASIDE.fullmatch(path.name)
            if found and not _runs(int(found[1] or found[2])):
                _drop(path)
    work = root / ".work"
    for stage in (p for p in work.iterdir() if p.is_dir() and not p.is_symlink()):
        for path in stage.iterdir():
            if KEY.fullmatch(path.name) and path.is_dir() and not path.is_symlink() and find(stage.name, path.name):
                _drop(path)


def _runs(process: int) -> bool:
    """Whether a process of this number is there: it may be about to rename what it wrote."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True  # another user's
    return True


def _drop(path: Path) -> None:
    with contextlib.suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
