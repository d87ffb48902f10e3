"""How many processor cores there are to work with."""

from __future__ import annotations

import os


def usable_cores() -> int:
    """Count the cores that this process may use.

    Returns:
        Those it is bound to, where the system tells (Linux); else all of the machine's.
    """
    bound = getattr(os, "sched_getaffinity", None)
    return len(bound(0)) if bound is not None else os.cpu_count() or 1
