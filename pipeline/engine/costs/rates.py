"""What stages took on this machine beside what they were estimated at: remembered for the user, in one small file.

The file lies in the user's cache (XDG_CACHE_HOME or ~/.cache): a rate is a fact of a machine and a program, not of a dataset,
and a new capture has no dataset yet. What a dataset's own manifests tell is added where they come from this machine.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.engine.costs.probe import cores, machine, slowness
from pipeline.engine.dataset.documents import read_object, write_whole

FILE = "rates.json"
SCHEMA = 2
"""Raised with every change of what stages estimate: a rate is of an estimate."""
KEPT = 3  # records of a stage and of a size (to the next power of two), the newest
DOUBT = 0.25
"""Weight of what is taken for granted beside a record of a run that was just as large, which weighs 1."""
OLDER = 0.5  # weight of a record that another version of the stage left
ALONE = 1.25
"""Wall seconds of a processor second from which on the machine was busy with other work, which says nothing of the next run."""
NEAR = 0.5  # likeness of size from which on the quickest run tells how many cores a stage has when it is alone
COMPILED = 0.25
"""Share of a run's time from which on compiling hides its rate: numba counts the compiler, not the keeping of its code."""
SHORTEST_S = 0.02  # of processor time, below which a record is all rounding


@dataclass(frozen=True)
class Record:
    """One run of a stage: the estimate (seconds of the reference machine), what it took, and the stage's version."""

    key: str
    estimate_s: float
    cpu_s: float
    wall_s: float
    version: int


@dataclass(frozen=True)
class Rate:
    """Processor seconds for one estimated, wall seconds for one of the processor; `known`: some run has shown it."""

    cpu: float
    wall: float
    known: bool


@dataclass
class Rates:
    """Records by stage and device."""

    records: dict[str, list[Record]] = field(default_factory=dict)

    def add(self, stage: str, device: str, record: Record) -> None:
        """Take a record in; one of the same version of a dataset only once."""
        kept = self.records.setdefault(f"{stage}@{device}", [])
        if record.cpu_s < SHORTEST_S or record.key in {r.key for r in kept}:
            return
        kept.append(record)
        alike = [r for r in kept if _size(r) == _size(record)]
        for r in alike[:-KEPT]:  # a hundred small runs push no large one out
            kept.remove(r)

    def of(self, stage: str, device: str, estimate_s: float, version: int, parallel: float) -> Rate:
        """The rate of a stage for work of such a size.

        A record counts the less the more its size differs: a small run is mostly start-up. Before any, and beside those of
        another size, stands what this machine's speed and its cores say (`parallel`: share of the work that spreads over them).
        """
        known = self.records.get(f"{stage}@{device}", [])
        cpu = [(DOUBT, math.log(slowness()))]
        wall = [(DOUBT, math.log(1 - parallel + parallel / cores()))]
        near = []
        for r in known:
            alike = math.exp(-abs(math.log(r.estimate_s / max(estimate_s, 1e-6))))
            weight = alike * (1.0 if r.version == version else OLDER)
            cpu.append((weight, math.log(r.cpu_s / r.estimate_s)))
            wall.append((weight, math.log(min(r.wall_s / r.cpu_s, ALONE))))
            near += [r.wall_s / r.cpu_s] if alike > NEAR else []
        return Rate(_mean(cpu), min([_mean(wall), *near]) if near else _mean(wall), bool(known))


def _size(record: Record) -> int:
    return round(math.log2(record.estimate_s))


def _mean(weighted: list[tuple[float, float]]) -> float:
    return math.exp(sum(w * x for w, x in weighted) / sum(w for w, _ in weighted))


def place() -> Path | None:
    """The file of this user's rates; None for one without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "polarfield" / FILE
    except RuntimeError:
        return None


def remembered() -> Rates:
    """What runs on this machine have shown; empty where nothing is kept or what is kept is damaged."""
    out, path = Rates(), place()
    kept = _machines(path).get(machine(), {}) if path else {}
    for name, rows in (kept if isinstance(kept, dict) else {}).items():
        stage, _, device = name.partition("@")
        for row in rows if isinstance(rows, list) else []:
            if (record := _record(row)) is not None:
                out.add(stage, device, record)
    return out


def remember(stage: str, device: str, record: Record) -> None:
    """Keep what a run has shown. Nothing happens where it cannot be kept: the next estimate is the worse for it, no more."""
    path = place()
    if path is None:
        return
    rates = remembered()
    rates.add(stage, device, record)
    machines = _machines(path)
    rows = {name: [vars(r) for r in kept] for name, kept in rates.records.items()}
    with contextlib.suppress(OSError):
        write_whole(path, json.dumps({"schema": SCHEMA, "machines": {**machines, machine(): rows}}, indent=1) + "\n")


def _machines(path: Path) -> dict[str, Any]:
    """What the file holds, by machine; nothing where it is damaged or of other estimates."""
    table = read_object(path) or {}
    machines = table.get("machines") if table.get("schema") == SCHEMA else None
    return machines if isinstance(machines, dict) else {}


def record_of(manifest: Mapping[str, Any], estimate_s: float) -> Record | None:
    """What a manifest of this machine tells of a stage that was estimated at so much; None of another machine's, and of a run
    that mostly compiled."""
    if manifest.get("machine") != machine():
        return None
    try:
        cpu, wall, compiled = (float(manifest[name]) for name in ("cpu_s", "wall_s", "compile_s"))
        if compiled > COMPILED * wall:
            return None
        cpu -= compiled * min(1.0, cpu / wall)  # compile_s is wall time, of one thread
        wall -= compiled
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return _record({
        "key": manifest.get("key"), "estimate_s": estimate_s, "cpu_s": cpu, "wall_s": wall, "version": manifest.get("version"),
    })  # fmt: skip


def _record(row: Any) -> Record | None:
    """A record whose parts have their types and are above 0; None of anything else."""
    if not isinstance(row, dict) or not isinstance(row.get("key"), str) or type(row.get("version")) is not int:
        return None
    numbers = [row.get(name) for name in ("estimate_s", "cpu_s", "wall_s")]
    if not all(isinstance(n, int | float) and math.isfinite(n) and n > 0 for n in numbers):
        return None
    estimate, cpu, wall = (float(n) for n in numbers if n is not None)
    return Record(row["key"], estimate, cpu, wall, row["version"])
