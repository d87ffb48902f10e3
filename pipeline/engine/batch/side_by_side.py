"""Run the stages of many captures side by side, within a number of processes and a budget of memory."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from pipeline.cores import usable_cores
from pipeline.engine.batch.logs import log_file, open_log
from pipeline.engine.batch.row import Row
from pipeline.engine.child import ended_by_signal, stage_command, stage_environment
from pipeline.engine.interrupts import GRACE_S, in_child, unheard
from pipeline.engine.plan import Step
from pipeline.engine.progress import Progress, brief
from pipeline.errors import UserError, line_of

TRIES = 3  # a stage that a signal ended is tried again: the machine may have been short of memory for a while
SAID = "polarfield: "
PROCESSES_CAN_BE_WAITED_FOR = hasattr(os, "pidfd_open")  # Linux; elsewhere they are looked at again and again
LOOK_AGAIN_S = 0.2
THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass
class Work:
    """A stage of one capture that is being made."""

    row: Row
    step: Step
    process: subprocess.Popen
    log: Path
    memory_mb: float
    started: float = field(default_factory=time.monotonic)


class SideBySide:
    """Makes what is left of every row: at most `jobs` stages at once, whose memory adds up to `memory_mb` at most.

    The first of each stage runs alone among its kind: it compiles the kernels that the others load.
    """

    def __init__(self, rows: list[Row], jobs: int, memory_mb: float, own: Path, progress: Progress) -> None:
        self.rows, self.jobs, self.memory_mb, self.own, self.progress = rows, jobs, memory_mb, own, progress
        self.running: dict[int, Work] = {}
        self.compiled: set[str] = set()
        self.tries: dict[tuple[str, str], int] = {}
        self.selector = selectors.DefaultSelector()
        self.environment = stage_environment()
        share = max(1, usable_cores() // jobs)
        for name in THREADS if jobs > 1 else ():
            self.environment.setdefault(name, str(share))

    def run(self) -> None:
        """Until nothing is left, or an interrupt: then the stages at work are ended within seconds, and it is raised on."""
        total = sum(len(row.left) for row in self.rows)
        with self.progress.bar("batch", total, "stages") as bar:
            try:
                while self._start_what_fits() or self.running:
                    for work in self._ended():
                        before = len(work.row.left)
                        self._conclude(work)
                        bar.advance(before - len(work.row.left), work.row.place.name)
            except BaseException:
                self._end_all()
                raise
            finally:
                for row in self.rows:
                    row.held.close()

    def _start_what_fits(self) -> bool:
        """Start what may run now; returns whether anything was."""
        started = False
        for row in self.rows:
            if len(self.running) >= self.jobs:
                break
            busy = {work.row.place.name for work in self.running.values()}
            if row.left and row.place.name not in busy and self._may_start(row.left[0], row):
                started |= self._start(row, row.left[0])
        return started

    def _may_start(self, step: Step, row: Row) -> bool:
        name = step.stage.name
        if name not in self.compiled and any(work.step.stage.name == name for work in self.running.values()):
            return False
        used = sum(work.memory_mb for work in self.running.values())
        return not self.running or used + row.memory_mb(step) <= self.memory_mb

    def _start(self, row: Row, step: Step) -> bool:
        assert row.call is not None
        try:
            if not row.begun:
                row.begin()
            name = step.stage.name
            log = log_file(self.own, row.place.name, name)
            with open_log(self.own, row.place.name, name, anew=True) as stream:
                command = stage_command(row.call, name, jobs=1)
                self._begin(row, step, command, stream, log)
        except (UserError, OSError) as error:
            self._fail(row, step, line_of(error))
        return True

    def _begin(self, row: Row, step: Step, command: list[str], stream: BinaryIO, log: Path) -> None:
        """Begin a stage's process, whose end is then waited for: an interrupt comes before both or after both."""
        with unheard():
            process = subprocess.Popen(
                command, env=self.environment, preexec_fn=in_child, stdout=stream, stderr=stream, stdin=subprocess.DEVNULL
            )
            self.running[process.pid] = Work(row, step, process, log, row.memory_mb(step))
            if PROCESSES_CAN_BE_WAITED_FOR:
                self.selector.register(os.pidfd_open(process.pid), selectors.EVENT_READ, process.pid)

    def _ended(self) -> Iterator[Work]:
        """Wait until at least one stage has ended."""
        for number in self._numbers_of_ended() if self.running else ():
            work = self.running.pop(number)
            work.process.wait()
            yield work

    def _numbers_of_ended(self) -> list[int]:
        if not PROCESSES_CAN_BE_WAITED_FOR:
            while not (ended := [number for number, work in self.running.items() if work.process.poll() is not None]):
                time.sleep(LOOK_AGAIN_S)
            return ended
        keys = [key for key, _ in self.selector.select()]
        for key in keys:
            self.selector.unregister(key.fd)
            os.close(key.fd)
        return [key.data for key in keys]

    def _conclude(self, work: Work) -> None:
        """What came of a stage: its version is put to use, or it is tried again, or its capture is given up."""
        row, step, status = work.row, work.step, work.process.returncode
        name = step.stage.name
        if status == 0:
            self.compiled.add(name)
            if row.use(step):
                row.made.append(name)
                row.left.pop(0)
                if not row.left:
                    row.end()
                    self.progress.say(f"{row.place.name}: done ({', '.join(row.made)} made)")
                return
            self._fail(row, step, f"{name}: the capture or the program was changed during the run; the same command goes on")
        elif status < 0 and self.tries.setdefault((row.place.name, name), 1) < TRIES:
            self.tries[row.place.name, name] += 1
            again = f"trying again ({self.tries[row.place.name, name]} of {TRIES})"
            said = f"ended by {signal.Signals(-status).name} after {brief(time.monotonic() - work.started)}"
            self.progress.say(f"{row.place.name}: {name} was {said}, {again}")
        else:
            self._fail(row, step, str(ended_by_signal(name, -status)) if status < 0 else last_words(work.log, name, status))

    def _fail(self, row: Row, step: Step, line: str) -> None:
        row.fault, row.at, row.left = line, step.stage.name, []
        self.progress.say(f"{row.place.name}: {step.stage.name} failed: {line}")
        if row.begun:
            row.end()

    def _end_all(self) -> None:
        """End what is at work: asked by SIGTERM, then by SIGKILL."""
        for work in self.running.values():
            work.process.terminate()
        deadline = time.monotonic() + GRACE_S
        for work in self.running.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                work.process.wait(max(deadline - time.monotonic(), 0.01))
            if work.process.poll() is None:
                work.process.kill()
                work.process.wait()


def last_words(log: Path, name: str, status: int) -> str:
    """The line with which a stage said why it ended, or where to read what it said."""
    try:
        lines = log.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    said = [line[len(SAID) :] for line in lines if line.startswith(SAID)]
    return said[-1] if said else f"{name}: ended with status {status}; {log} has what it said"
