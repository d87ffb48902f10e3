"""A batch as a Slurm array: one task a capture, requeued when it is killed or out of time, and a last job that gathers."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.engine.batch.plan_file import read_plan
from pipeline.engine.child import stage_environment
from pipeline.engine.dataset.documents import write_whole
from pipeline.errors import UserError

ROUNDS = 4  # arrays that are submitted for what is left, the first one included
RESTARTS = 3  # of one task within a round
NOTICE_S = 60  # before the time limit: a checkpoint takes well under a second, a library that hears no signal a few

SCRIPT = """#!/bin/bash
{directives}
# Written by `polarfield batch --slurm`. Exit statuses: 0 done, 2 a fault that trying again does not mend.
export PYTHONPATH={path}${{PYTHONPATH:+:$PYTHONPATH}}
trap 'kill -TERM "$work" 2>/dev/null' TERM  # a minute before the time limit, and before preemption
{job} "$SLURM_ARRAY_TASK_ID" all &
work=$!
wait "$work"
status=$?
while kill -0 "$work" 2>/dev/null; do  # a signal ended the wait, not the work
  wait "$work"
  status=$?
done
if [ "$status" -ne 0 ] && [ "$status" -ne 2 ] && [ "${{SLURM_RESTART_COUNT:-0}}" -lt {restarts} ]; then
  scontrol requeue "$SLURM_JOB_ID"  # goes on from what is done
fi
exit "$status"
"""


def submit(plan: Path, again: Sequence[str], sbatch: str, jobs: int, round_number: int) -> str:
    """Write `batch.sbatch` beside the plan and submit it, and a job that gathers after it; returns the array's number.

    again: the command that gathers (it submits what is left, in the next round). sbatch: more options for sbatch.
    Raises UserError.
    """
    try:
        more = shlex.split(sbatch)
    except ValueError as error:
        raise UserError("--sbatch", f"cannot be split ({error})", "quote values that hold spaces") from error
    facts, own = read_plan(plan), plan.parent
    script = own / "batch.sbatch"
    write_whole(script, script_of(facts, plan, jobs))
    number = _sbatch([*more, str(script.absolute())])
    gather = [sys.executable, "-m", facts["module"], *again, "--round", str(round_number + 1)]
    root = shlex.quote(str(Path(__file__).resolve().parents[3]))
    wrap = f"PYTHONPATH={root}${{PYTHONPATH:+:$PYTHONPATH}} {shlex.join(gather)}"
    log = str((own / "logs" / "table.log").absolute()).replace("%", "%%")
    after = [f"--dependency=afterany:{number}", "--requeue", "--open-mode=append", f"--output={log}", "--mem=2000M"]
    _sbatch(["--job-name=polarfield-table", *after, *_without_resources(more), f"--wrap={wrap}"])
    return number


def script_of(facts: Mapping[str, Any], plan: Path, jobs: int) -> str:
    """The text of the array's script; `jobs` tasks at once, 1 for as many as Slurm likes."""
    rows = facts["rows"]
    logs = (plan.parent / "logs").absolute()
    logs.mkdir(parents=True, exist_ok=True)
    at_once = f"%{jobs}" if jobs > 1 else ""
    options = {
        "job-name": "polarfield",
        "array": f"0-{len(rows) - 1}{at_once}",
        "cpus-per-task": facts["cores"],
        "mem": f"{max(row['memory_mb'] for row in rows)}M",
        **({"gpus": 1} if any(row["gpu"] for row in rows) else {}),
        "requeue": None,
        "open-mode": "append",
        "signal": f"B:TERM@{NOTICE_S}",
        "output": f"{logs}".replace("%", "%%") + "/slurm-%a.log",
    }
    lines = [f"#SBATCH --{name}" + ("" if value is None else f"={value}") for name, value in options.items()]
    job = shlex.join([sys.executable, "-m", facts["module"], "job", str(plan.absolute())])
    root = shlex.quote(str(Path(__file__).resolve().parents[3]))
    return SCRIPT.format(directives="\n".join(lines), path=root, job=job, restarts=RESTARTS)


def _sbatch(options: Sequence[str]) -> str:
    """Submit; returns the job's number. Raises UserError."""
    try:
        done = subprocess.run(["sbatch", "--parsable", *options], capture_output=True, text=True, env=stage_environment())
    except FileNotFoundError:
        raise UserError("sbatch", "is not on this machine", "submit from a login node of the cluster") from None
    found = re.match(r"(\d+)", done.stdout.strip())
    if done.returncode or not found:
        said = done.stderr.strip() or f"it said {done.stdout.strip()!r}"
        raise UserError("sbatch", said, "mend --sbatch (account, partition, time)")
    return found[1]


def _without_resources(options: Sequence[str]) -> list[str]:
    return [o for o in options if not re.match(r"--(gres|gpus|mem|array|cpus-per-task|gpus-per-task)\b", o)]
