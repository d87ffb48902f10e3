"""What a part of a stage takes on the machine that the figures were found on."""

from __future__ import annotations

from dataclasses import dataclass

ITSELF = ""
"""The part of a stage that is no pass: what it takes where every pass is left out."""
COMPILING = "compiling"
"""The part that a machine takes once: machine code of kernels that are not kept yet."""


@dataclass(frozen=True)
class Cost:
    """What a stage, or a pass of one, takes: seconds of one core of the reference machine, and MiB that it adds to the peak."""

    cpu_s: float
    memory_mb: float = 0.0
