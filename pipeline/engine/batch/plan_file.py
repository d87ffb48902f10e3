"""A batch's plan as a file, for machines that are not this one: `DATASETS/.batch/plan.json`, and a job of it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.engine.batch.row import Row
from pipeline.engine.batch.side_by_side import THREADS, last_words
from pipeline.engine.child import stage_command
from pipeline.engine.dataset.documents import read_object, write_whole
from pipeline.errors import UserError

SCHEMA = 1
REFUSED = 2  # the status of a fault that trying again does not mend
SPARE = 1.3  # what is asked of a cluster over the estimate, which is good to so much


def write_plan(rows: Sequence[Row], own: Path, cores: int, plan_id: str) -> Path:
    """Write what is left of these captures to `own`/plan.json, and have their datasets ready; returns its path.

    Each row tells `name`, `dataset`, `arguments` of the command for all of it, `memory_mb`, `gpu`, and its `stages`: by name
    the `key`, the keys of the stages that it `needs` and are left, `arguments`, `memory_mb` and `gpu`.
    """
    table = []
    for row in rows:
        assert row.call is not None
        with row.held:
            row.begin()
        table.append(_row(row))
    stages = list(dict.fromkeys(name for r in table for name in r["stages"]))
    facts = {"schema": SCHEMA, "id": plan_id, "module": rows[0].call.program.module if rows[0].call else ""}
    path = own / "plan.json"
    write_whole(path, json.dumps({**facts, "cores": cores, "stages": stages, "rows": table}, indent=1) + "\n")
    return path


def _row(row: Row) -> dict[str, Any]:
    call = row.call
    assert call is not None
    left = {step.stage.name: step for step in row.left}
    stages: dict[str, dict[str, Any]] = {
        name: {
            "key": step.key,
            "needs": {n: left[n].key for n in step.needs if n in left},
            "arguments": _absolute(stage_command(call, name, jobs=1)[3:], call.capture.root, call.dataset.root),
            "memory_mb": round(SPARE * row.memory_mb(step)),
            "gpu": int(step.stage.device and call.options.device == "cuda"),
        }
        for name, step in left.items()
    }
    whole = ["all", *(a for a in next(iter(stages.values()))["arguments"][1:] if a != "--alone")]
    return {
        "name": row.place.name,
        "dataset": str(call.dataset.root.absolute()),
        "arguments": whole,
        "memory_mb": max(s["memory_mb"] for s in stages.values()),
        "gpu": max(s["gpu"] for s in stages.values()),
        "stages": stages,
    }


def _absolute(arguments: list[str], *paths: Path) -> list[str]:
    known = {str(path): str(path.absolute()) for path in paths}
    return [known.get(a, a) for a in arguments]


def run_job(arguments: Sequence[str], main: Any) -> int:
    """Run `job PLAN ROW STAGE` (or `all` for every stage of the row) in this process; returns its exit status.

    What it prints goes to the log of the capture. A fault that was told under this plan is not tried again.
    `main` runs a command line.
    """
    path, number, stage = Path(arguments[0]), int(arguments[1]), arguments[2]
    plan = read_plan(path)
    row = plan["rows"][number]
    own = path.parent
    log = own / "logs" / row["name"] / f"{stage}.log"
    if (told := told_fault(own, row["name"], plan["id"])) is not None:
        print(f"polarfield: {told}", file=sys.stderr)
        return REFUSED
    log.parent.mkdir(parents=True, exist_ok=True)
    for name in THREADS:
        os.environ.setdefault(name, str(plan["cores"]))
    with log.open("ab") as stream:
        sys.stdout.flush()
        sys.stderr.flush()
        for handle in (1, 2):
            os.dup2(stream.fileno(), handle)
    try:
        status = main(row["arguments"] if stage == "all" else row["stages"][stage]["arguments"])
    except SystemExit as ended:  # as a stage's own process did
        status = int(ended.code or 0)
    if status == REFUSED:
        fault = {"plan": plan["id"], "stage": stage, "line": last_words(log, stage, status)}
        write_whole(_fault_file(own, row["name"]), json.dumps(fault) + "\n")
    return status


def read_plan(path: Path) -> Mapping[str, Any]:
    """The plan in a file. Raises UserError."""
    plan = read_object(path)
    if plan is None or plan.get("schema") != SCHEMA or not isinstance(plan.get("rows"), list):
        raise UserError(path, "is no plan of a batch", "`polarfield batch` writes it")
    return plan


def told_fault(own: Path, name: str, plan_id: str) -> str | None:
    """The line with which a capture was refused under a plan, or None."""
    fault = read_object(_fault_file(own, name)) or {}
    return str(fault.get("line", "")) if fault.get("plan") == plan_id else None


def tell_faults(rows: Sequence[Row], own: Path, plan_id: str) -> None:
    """Give the rows that were refused under a plan their line: nothing is left to do of them."""
    for row in rows:
        fault = read_object(_fault_file(own, row.place.name)) or {}
        if row.left and fault.get("plan") == plan_id:
            row.fault, row.at, row.left = str(fault.get("line", "")), str(fault.get("stage", "")), []


def _fault_file(own: Path, name: str) -> Path:
    return own / "faults" / f"{name}.json"
