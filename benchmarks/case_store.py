"""Stored results of a benchmark, case by case: what is there is kept as long as it was made with today's defaults."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

REPEATS = 5


class CaseStore:
    """Cases by name in one JSON file: {"machine", "cases": {NAME: {"defaults", ...}}}.

    defaults: values that the program has today; a case that was made with others is made again.
    """

    def __init__(self, path: Path, defaults: Mapping[str, Any]) -> None:
        self.path, self.defaults = path, json.loads(json.dumps(defaults))
        table = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        self.cases: dict[str, dict[str, Any]] = {
            name: case for name, case in table.get("cases", {}).items() if case.get("defaults") == self.defaults
        }

    def run(self, name: str, measure: Callable[[], Mapping[str, Any]], default: bool = False) -> dict[str, Any]:
        """The figures of a case: those stored, else measured now and stored at once; `default`: it is what the program does."""
        if name not in self.cases:
            self.cases[name] = {"defaults": self.defaults, "default": default, **stamp(), **measure()}
            self._write()
        return self.cases[name]

    def _write(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        aside = self.path.with_suffix(".part")
        aside.write_text(json.dumps({"cases": self.cases}, indent=1) + "\n", encoding="utf-8")
        aside.replace(self.path)


def made_with(defaults: Any) -> dict[str, Any]:
    """What a stored result keeps of how it was made: the defaults (a parameters' dataclass, or a table), and the stamp."""
    table = asdict(defaults) if is_dataclass(defaults) and not isinstance(defaults, type) else defaults
    return {"defaults": json.loads(json.dumps(table)), **stamp()}


def stamp() -> dict[str, str]:
    """Machine, commit and day, for a stored case."""
    root = Path(__file__).parents[1]
    asked = subprocess.run(["git", "-C", str(root), "rev-parse", "--short=12", "HEAD"], capture_output=True, text=True)
    cores = len(os.sched_getaffinity(0))
    return {
        "machine": f"{platform.machine()}, {cores} core{'s' * (cores > 1)}", "commit": asked.stdout.strip() or "unknown",
        "date": time.strftime("%Y-%m-%d"),
    }  # fmt: skip


def median_s(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median processor seconds of a call, after one to warm up: what else runs on the machine counts least so."""
    call()
    found = []
    for _ in range(repeats):
        started = time.process_time()
        call()
        found.append(time.process_time() - started)
    return sorted(found)[len(found) // 2]
