"""A stage in a process of its own: its memory is its own, and a crash of a native library ends the stage alone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from pipeline.engine.call import Call
from pipeline.engine.interrupts import in_child, unheard, wait_for
from pipeline.errors import UserError


def stage_command(call: Call, name: str, jobs: int | None = None) -> list[str]:
    """The command line that makes one stage alone, as this call would; `jobs`: another number of pieces side by side."""
    options = call.options
    command = [sys.executable, "-m", call.program.module, name, str(call.capture.root), "--alone"]
    command += ["--dataset", str(call.dataset.root)]
    command += [f"--params={call.settings.params_text()}", f"--envs={call.settings.envs_text()}"]
    command += ["--memory", options.memory] if options.memory else []
    return command + ["--device", options.device, "--jobs", str(jobs or options.jobs)] + (["--quiet"] if options.quiet else [])


def stage_environment() -> dict[str, str]:
    """The environment of a stage's process: this program is found first, and threads sleep while they wait unless the user has
    said otherwise: those that spin take the cores from each other as soon as anything else runs."""
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]))
    return {"OMP_WAIT_POLICY": "PASSIVE", **os.environ, "PYTHONPATH": path}


def run_stage(call: Call, name: str) -> int:
    """Run one stage in a child and wait for it; returns its exit status. Raises UserError where a signal ended it."""
    sys.stdout.flush()
    with unheard():
        child = subprocess.Popen(stage_command(call, name), env=stage_environment(), preexec_fn=in_child)
    status = wait_for(child)
    if status < 0:
        raise ended_by_signal(name, -status)
    return status


def ended_by_signal(name: str, number: int) -> UserError:
    """What to say of a stage that a signal ended: no fault of input, so that the status is the signal's."""
    hint = "it may have run out of memory; " if number == signal.SIGKILL else ""
    error = UserError(name, f"the stage was ended by {signal.Signals(number).name}", f"{hint}the same command resumes it")
    error.status = 128 + number
    return error
