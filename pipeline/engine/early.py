"""What `plan` and `inspect` say ahead of a run: warnings, and the fault that would end it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence

from pipeline.capture import Capture
from pipeline.engine.changes import State
from pipeline.engine.plan import Step
from pipeline.errors import UserError

Look = Callable[[Capture, Sequence[Step], Mapping[str, State], float], tuple[Sequence[str], UserError | None]]
"""What a run would warn of, and the fault that would end it, found by reading about so many million pixels."""
LOOKED_AT_MP = {"plan": 4.0, "inspect": 64.0}
"""Of frames, read for `plan` and `inspect`: 32 Stokes images of 512 x 512 with masks took 7 s of the processor."""


def say_warnings(warnings: Sequence[str]) -> None:
    """Print warnings, a line each, at once."""
    for warning in warnings:
        print(f"warning: {warning}")
    sys.stdout.flush()


def look_early(
    look: Look | None, capture: Capture, steps: Sequence[Step], found: Mapping[str, State], command: str, said: Sequence[str]
) -> tuple[list[str], UserError | None]:
    """Say what a run would warn of beyond what was `said`; returns that, and the fault that would end it, if any."""
    if look is None:
        return [], None
    seen, fault = look(capture, steps, found, LOOKED_AT_MP[command])
    new = [warning for warning in seen if warning not in said]
    say_warnings(new)
    return new, fault
