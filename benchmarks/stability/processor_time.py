"""Processor time of the programs that a case runs: the machine may be busy with others."""

from __future__ import annotations

import resource


def spent() -> float:
    """Seconds of processor time that finished child processes have used so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def processor_s() -> float:
    """Seconds of processor time of this program and of its finished children so far."""
    own = resource.getrusage(resource.RUSAGE_SELF)
    return own.ru_utime + own.ru_stime + spent()
