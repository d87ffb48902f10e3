"""python -m benchmarks [--captures FOLDER] [--photographs FOLDER] [--only NAME ...] [--again]: benchmarks, then their page.

What was finished at this commit is not run again, so that a killed call goes on where it was (--again begins anew); most keep
their cases one by one besides. Those that need captures or photographs are named and left out without them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.case_store import stamp

ROOT = Path(__file__).parents[1]
STATE = ROOT / "build" / "bench" / "finished.json"
RESULTS = ROOT / "benchmarks" / "results"
ALWAYS = {
    "approximations": [], "mesh": [], "rasterize": ["--json", str(RESULTS / "rasterize.json")],
    "shading": ["--json", str(RESULTS / "shading.json")],
}  # fmt: skip
"""Benchmarks that make all that they measure, with their arguments."""
ON_CAPTURES = {
    "decode": [], "masks": [], "olat": [], "overexposure": [], "train": ["--out", str(RESULTS), "--resume"],
    "light": ["--out", str(RESULTS)], "ablation": ["--out", str(RESULTS)], "assets": [],
}  # fmt: skip
"""Benchmarks on captures with ground truth."""
PHOTOGRAPHS = "castle"
"""Folder of photographs among the captures that poses are found from."""


def jobs(captures: str, photographs: str) -> dict[str, list[str]]:
    """Each benchmark's arguments, by name, in order; without captures only those that need none."""
    out = {name: list(arguments) for name, arguments in ALWAYS.items()}
    if captures:
        out |= {name: ["--captures", captures, *arguments] for name, arguments in ON_CAPTURES.items()}
        photographs = photographs or str(Path(captures) / PHOTOGRAPHS)
    if photographs and Path(photographs).is_dir():
        out["poses"] = [photographs]
    return out


def main() -> int:
    """Run what is not finished; 1 where a benchmark failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", default=os.environ.get("POLARFIELD_CAPTURES", ""), help="folder of captures with truth")
    parser.add_argument("--photographs", default="", help=f"folder of photographs; CAPTURES/{PHOTOGRAPHS} where it is there")
    parser.add_argument("--only", nargs="*", choices=[*ALWAYS, *ON_CAPTURES, "poses"], help="run these, finished or not")
    parser.add_argument("--again", action="store_true", help="also what was finished at this commit")
    options = parser.parse_args()
    possible, commit, failed = jobs(options.captures, options.photographs), stamp()["commit"], []
    asked = options.only or [*ALWAYS, *ON_CAPTURES, "poses"]
    wanted = {name: possible[name] for name in asked if name in possible}
    for name in asked:
        if name not in wanted:
            print(f"{name}: left out (it needs {'photographs' if name == 'poses' else 'CAPTURES=folder with ground truth'})")
    finished = {} if options.again or options.only else finished_before()
    for name, arguments in wanted.items():
        if finished.get(name) == [commit, arguments]:
            print(f"{name}: finished before")
            continue
        print(f"{name}: running", flush=True)
        started = time.monotonic()
        status = subprocess.run([sys.executable, "-m", f"benchmarks.bench_{name}", *arguments], cwd=ROOT).returncode
        if status:
            failed.append(name)
            print(f"{name}: failed with status {status}", flush=True)
            continue
        finished[name] = [commit, arguments]
        STATE.parent.mkdir(parents=True, exist_ok=True)
        STATE.write_text(json.dumps(finished, indent=1) + "\n")
        print(f"{name}: done in {time.monotonic() - started:.0f} s", flush=True)
    subprocess.run([sys.executable, "-m", "benchmarks.report"], cwd=ROOT, check=True)
    return 1 if failed else 0


def finished_before() -> dict[str, list]:
    """[commit, arguments] of what was finished, by name; nothing where that cannot be read."""
    try:
        table = json.loads(STATE.read_text())
    except (OSError, ValueError):
        return {}
    return table if isinstance(table, dict) else {}


if __name__ == "__main__":
    sys.exit(main())
