"""Parameters of the decode stage."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class DecodeParameters:
    """How frames are written."""

    precision: Literal["auto", "half", "float"] = field(
        default="auto", metadata={"help": "of the frames: half floats where they hold the values, or always one"}
    )
