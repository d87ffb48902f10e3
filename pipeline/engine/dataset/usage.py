"""What a run of a stage costs: wall and CPU seconds over all its legs, and peak memory with its children."""

from __future__ import annotations

import json
import os
import resource
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.engine.dataset.documents import read_object

PROCESSES = Path("/proc")
LISTED = PROCESSES / "thread-self/children"
"""Linux lists a thread's children where it was built to."""
PAGE = os.sysconf("SC_PAGE_SIZE")


def _tree(root: int) -> list[int]:
    """A process and all its descendants."""
    found, queue = [], [root]
    tree = None if LISTED.exists() else _children()
    while queue:
        pid = queue.pop()
        found.append(pid)
        queue += _listed_children(pid) if tree is None else tree.get(pid, [])
    return found


def _listed_children(pid: int) -> list[int]:
    """A process's children, of whichever thread."""
    out: list[int] = []
    try:
        for task in os.listdir(PROCESSES / str(pid) / "task"):
            out += map(int, (PROCESSES / str(pid) / "task" / task / "children").read_text().split())
    except OSError:
        pass  # it, or a thread of it, ended meanwhile
    return out


def _children() -> dict[int, list[int]]:
    """Child process ids by parent, for all processes that one can see: on a busy machine hundreds of files are read."""
    out: dict[int, list[int]] = {}
    for entry in os.listdir(PROCESSES):
        if entry.isdigit():
            try:
                parent = int((PROCESSES / entry / "stat").read_text().rpartition(")")[2].split()[1])
            except (OSError, IndexError, ValueError):
                continue  # it ended meanwhile
            out.setdefault(parent, []).append(int(entry))
    return out


def _resident_bytes() -> int:
    """Resident memory of this process and all its descendants; where no system tells (/proc), the peak of either."""
    if not PROCESSES.exists():
        return max(_peak_bytes(resource.RUSAGE_SELF), _peak_bytes(resource.RUSAGE_CHILDREN))
    total = 0
    for pid in _tree(os.getpid()):
        try:
            total += int((PROCESSES / str(pid) / "statm").read_text().split()[1]) * PAGE
        except (OSError, IndexError):
            continue  # it ended meanwhile
    return total


def _own_peak_bytes() -> int:
    if not PROCESSES.exists():
        return _peak_bytes(resource.RUSAGE_SELF)
    for line in (PROCESSES / "self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return 0


def _peak_bytes(whose: int) -> int:
    return resource.getrusage(whose).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


class Usage:
    """Watches this process from `start` to `stop`; survives kills by noting its figures beside the checkpoints.

    Where it has more than `limit_mb` in memory, `overrun` is called, in another thread than the work's.
    """

    INTERVAL_S = 0.5

    def __init__(self, record: Path, limit_mb: float = float("inf"), overrun: Callable[[], None] | None = None) -> None:
        self.record, self.limit, self.overrun = record, limit_mb * 2**20, overrun
        self.before: dict[str, Any] = {"started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}
        self.before |= {"wall_s": 0.0, "cpu_s": 0.0, "peak_rss_mb": 0.0}
        earlier = read_object(record) or {}
        if all(type(earlier.get(name)) is type(value) for name, value in self.before.items()):
            self.before = earlier
        self.peak = 0
        self.started = time.monotonic()
        self.cpu = self._cpu_s()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    @staticmethod
    def _cpu_s() -> float:
        t = os.times()
        return t.user + t.system + t.children_user + t.children_system

    def _watch(self) -> None:
        while not self._done.wait(self.INTERVAL_S):
            now = _resident_bytes()
            self.peak = max(self.peak, now)
            if now > self.limit and self.overrun is not None:
                self.overrun()
            aside = self.record.with_suffix(".new")
            try:
                aside.write_text(json.dumps(self.figures()))
                aside.replace(self.record)
            except OSError:
                continue  # a full disk will be reported by the stage itself

    def figures(self) -> dict[str, float | str]:
        """Start time, wall_s, cpu_s and peak_rss_mb over all legs so far."""
        peak = max(self.peak, _own_peak_bytes()) / 2**20
        return {
            "started": self.before["started"],
            "wall_s": round(self.before["wall_s"] + time.monotonic() - self.started, 3),
            "cpu_s": round(self.before["cpu_s"] + self._cpu_s() - self.cpu, 3),
            "peak_rss_mb": round(max(self.before["peak_rss_mb"], peak), 1),
        }

    def stop(self) -> dict[str, float | str]:
        """End the watch and return the figures."""
        self._done.set()
        self._thread.join()
        return self.figures()
