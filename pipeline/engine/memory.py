"""How much memory there is, and how much of it a call may take."""

from __future__ import annotations

import os
import re
from pathlib import Path

from pipeline.errors import UserError

UNITS = {"K": 2**-10, "M": 1.0, "G": 2**10, "T": 2**20}  # MiB
CGROUPS = Path("/sys/fs/cgroup")


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
