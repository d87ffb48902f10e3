"""python -m benchmarks.stability: run every part, keep each case as it ends, write docs/stability.md, exit 1 on a failure.

Cases that this commit has already run are not run again (--fresh: all are). --parts chooses some; --cases runs these whole runs
again and keeps every other row.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from datetime import date
from pathlib import Path

from benchmarks.stability import functions, fused, light_stage, options, repeats, whole_runs
from benchmarks.stability.extreme_scenes import SCENES, SPOILED
from benchmarks.stability.page import TITLES, page
from benchmarks.stability.processor_time import processor_s
from benchmarks.stability.verdicts import Row

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "stability.json"
PAGE = ROOT / "docs" / "stability.md"


def main() -> int:
    """Run, write, and say."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="*", choices=list(TITLES), default=list(TITLES))
    parser.add_argument("--fresh", action="store_true", help="run again what this commit has already run")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "stability", help="where captures and datasets lie")
    parser.add_argument("--cases", nargs="*", choices=[*SCENES, *SPOILED], default=[], help="of the whole runs, by name")
    given = parser.parse_args()
    stamp = {"commit": _commit(), "machine": _machine(), "date": f"{date.today():%Y-%m-%d}"}
    stored = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {"rows": []}
    kept = [Row(**row) for row in stored["rows"]]
    for part in ["whole runs"] if given.cases else given.parts:
        over = {row.name for row in kept if row.part == part and row.name not in given.cases} if given.cases else set()
        if not given.cases:
            if stored.get("finished", {}).get(part) == stamp["commit"] and not given.fresh:
                continue
            stored.get("finished", {}).pop(part, None)
            # Whole runs take minutes: those that this commit has run stay. Other parts are begun again.
            if part == "whole runs" and not given.fresh:
                over = {row.name for row in kept if row.part == part and row.commit == stamp["commit"]}
        kept = [row for row in kept if row.part != part or row.name in over]
        begun = processor_s()
        for row in PARTS[part](given.work, over):
            kept.append(replace(row, commit=stamp["commit"]))
            _write(kept, stamp, stored)
            print(f"{'sound' if row.sound else 'FAILS'}  {row.part}: {row.name}, {row.setting}  {row.why}", flush=True)
        if not given.cases:
            stored.setdefault("finished", {})[part] = stamp["commit"]
        if not over:
            stored.setdefault("cpu_s", {})[part] = round(processor_s() - begun, 1)
        _write(kept, stamp, stored)
    failed = sum(not row.sound for row in kept)
    print(f"{len(kept)} cases, {failed} fail: {PAGE}")
    return 1 if failed else 0


def _write(rows: list[Row], stamp: dict[str, str], stored: dict) -> None:
    """Keep the rows so far, and the page that they make."""
    names = [*SCENES, *SPOILED]
    rows.sort(key=lambda row: (list(TITLES).index(row.part), names.index(row.name) if row.name in names else 0))
    of_parts = {name: stored.get(name, {}) for name in ("finished", "cpu_s")}
    out = {**stamp, **of_parts, "rows": [asdict(row) for row in rows]}
    part = RESULTS.with_suffix(".part")
    part.write_text(json.dumps(out, indent=1) + "\n")
    part.replace(RESULTS)
    PAGE.write_text(page(rows, out))


def _captures(work: Path) -> Path:
    """Where the small captures `views` and `stage` lie, made if they are not there."""
    captures = work / "tiny"
    if not (captures / "stage").is_dir():
        size = ["--size", "64", "--spp", "48", "--lights", "24"]
        subprocess.run([sys.executable, "-m", "synth", str(captures), *size], check=True, cwd=ROOT)
    return captures


PARTS: dict[str, Callable[[Path, set[str]], Iterator[Row]]] = {
    "functions": lambda work, over: functions.rows(),
    "kernels": lambda work, over: fused.rows(),
    "light stage": lambda work, over: light_stage.rows(),
    "whole runs": whole_runs.rows,
    "options": lambda work, over: options.rows(_captures(work) / "stage", work / "options"),
    "repeats": lambda work, over: repeats.rows(_captures(work), work / "repeats"),
}


def _commit() -> str:
    done = subprocess.run(["git", "describe", "--always", "--dirty", "--abbrev=10"], cwd=ROOT, capture_output=True, text=True)
    return done.stdout.strip() or "not known"


def _machine() -> str:
    import os

    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"


if __name__ == "__main__":
    sys.exit(main())
