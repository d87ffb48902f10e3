"""How much memory there is, and how much of it a call may take."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.plan import Step
from pipeline.errors import UserError

UNITS = {"K": 2**-10, "M": 1.0, "G": 2**10, "T": 2**20}  # MiB
CGROUPS = Path("/sys/fs/cgroup")
NEARLY_ALL = 0.97  # of the machine's memory: past it the kernel ends a process, and says nothing to it


@dataclass(frozen=True)
class Allowance:
    """What a stage will take (MiB), how many pieces side by side that is for, and how much it may take before it is stopped."""

    expected_mb: float
    jobs: int
    limit_mb: float
    given: bool = False

    def overrun(self, stage: str) -> str:
        """The line with which a stage is stopped."""
        whose = "MEMORY (--memory)" if self.given else "this machine"
        fault = f"takes more than the {self.limit_mb:.0f} MB that {whose} allows it, and was stopped"
        return str(UserError(stage, fault, "give it more, or smaller images; the same command goes on from its checkpoint"))


def allowance(step: Step, capture: Capture, jobs: int, given: str) -> Allowance:
    """How a stage fits into the memory that is `given` (text, empty: the machine's), with fewer jobs side by side if need be.

    Raises UserError where one job alone would take more than was given.
    """
    name = step.stage.name

    def expected_mb(count: int) -> float:
        return step.stage.memory(capture, step.parameters, count)

    if not given:
        return Allowance(expected_mb(jobs), jobs, NEARLY_ALL * machine_mb())
    limit = parsed_mb(given)
    fitting = next((count for count in range(jobs, 0, -1) if expected_mb(count) <= limit), None)
    if fitting is None:
        fault = f"needs about {expected_mb(1):.0f} MB of memory, and MEMORY (--memory) is {limit:.0f} MB"
        raise UserError(name, fault, "give it more, or smaller images")
    return Allowance(expected_mb(fitting), fitting, limit, given=True)


def parsed_mb(text: str) -> float:
    """`16G`, `1500M` (or megabytes without a letter) as MiB. Raises UserError."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", text, re.IGNORECASE)
    if not found or float(found[1]) <= 0:
        raise UserError("MEMORY (--memory)", f"{text!r} is not an amount of memory", "as in 16G or 1500M")
    return float(found[1]) * UNITS[found[2].upper() or "M"]


def machine_mb() -> float:
    """MiB that this process and its children may have: the machine's, or less where a cluster's job or a container has less."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**20]
    for path in _limits_of_control_groups():
        try:
            limits.append(int(path.read_text()) / 2**20)
        except (OSError, ValueError):
            continue  # "max", or no such controller
    return min(limits)


def _limits_of_control_groups() -> list[Path]:
    """Files of the limits on this process: its control group's and those above it, of either version of control groups."""
    try:
        lines = Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:
        return []
    out = []
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if controllers not in ("", "memory") and "memory" not in controllers.split(","):
            continue
        root, name = (CGROUPS, "memory.max") if not controllers else (CGROUPS / "memory", "memory.limit_in_bytes")
        folder = root / group.lstrip("/")
        out += [parent / name for parent in (folder, *folder.parents) if parent.is_relative_to(root)]
    return out
