"""What a part of a stage takes on the machine that the figures were found on."""

from __future__ import annotations

from dataclasses import dataclass

ITSELF = ""
"""The part of a stage that is no pass: what it takes where every pass is left out."""
COMPILING = "compiling"
"""The part that a machine takes once: machine code of kernels that are not kept yet."""


@dataclass(frozen=True)
class Cost:
    """What a stage, or a pass of one, takes.

    Fields:
        cpu_s: seconds of one core of the reference machine.
        memory_mb: MiB that it has at its peak (a stage) or adds to it (a pass).
    """

    cpu_s: float
    memory_mb: float = 0.0
