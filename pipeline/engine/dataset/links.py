"""Nothing is written or deleted behind a link in a dataset, which may have been handed over by anyone."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from pipeline.errors import UserError


def refuse_links(root: Path, folder: Path) -> None:
    """Raise UserError where `folder`, or one between it and the dataset's root, is a link. The root itself may be one."""
    path = root
    for part in folder.relative_to(root).parts:
        path = path / part
        if path.is_symlink():
            fault = "is a link, and nothing is written or deleted behind one"
            raise UserError(path, fault, "put what it names there in its place, or choose another DATASET=")


def holds_what_no_run_leaves(folder: Path) -> bool:
    """Whether anything below a folder is a link, a pipe or a device: stages make files and folders alone."""
    for where, folders, names in os.walk(folder):
        for name in (*folders, *names):
            mode = (Path(where) / name).lstat().st_mode
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                return True
    return False
