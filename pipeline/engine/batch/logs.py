"""What the stages of a batch printed: a file each, opened without following links, which anyone may have left there."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

from pipeline.engine.dataset.links import refuse_links


def log_file(own: Path, capture: str, stage: str) -> Path:
    """Where the log of a stage of a capture lies; `own`: what the batch keeps beside the datasets."""
    return own / "logs" / capture / f"{stage}.log"


def open_log(own: Path, capture: str, stage: str, anew: bool) -> BinaryIO:
    """The log, to be written from its start (`anew`) or added to. Raises UserError where a folder of it is a link, OSError."""
    path = log_file(own, capture, stage)
    refuse_links(own.parent, path.parent)
    path.parent.mkdir(parents=True, exist_ok=True)
    flags = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | (os.O_TRUNC if anew else os.O_APPEND)
    return os.fdopen(os.open(path, flags, 0o666), "wb")
