"""Work in a fork of a process that has loaded everything."""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn, TypeVar

T = TypeVar("T")
FAILED = 99  # exit status of work that ended in an exception
LOADED = "POLARFIELD_LOADED_MODULES"
"""Names a file that forks add the modules to that they have loaded."""


def end_as(work: Callable[[], int], log: Path | None) -> NoReturn:
    """In a fork: do the work, what it says going to a file, and end the process with its status."""
    status = FAILED
    try:
        if log is not None:
            stream = open(log, "a", buffering=1)  # noqa: SIM115
            sys.stdout = sys.stderr = stream
            os.dup2(stream.fileno(), 1)
            os.dup2(stream.fileno(), 2)
        status = work()
    except SystemExit as ended:
        status = int(ended.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        if names := os.environ.get(LOADED):
            with open(names, "a") as told:
                told.write("\n".join([*sys.modules, ""]))
        os._exit(status)


def started(work: Callable[[], int], log: Path | None = None) -> int:
    """The process of `work`."""
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        end_as(work, log)
    return pid


def status_of(pid: int) -> int:
    """The exit status of a process, when it has ended."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def forked(work: Callable[[], int], log: Path | None = None) -> int:
    """The exit status of `work` in a fork whose output goes to a file, if one is given."""
    return status_of(started(work, log))


def side_by_side(works: Sequence[Callable[[], T]]) -> list[T]:
    """What each of these gives, each worked out in a fork of its own."""
    pipes = []
    for work in works:
        here, there = os.pipe()
        pid = started(lambda: _told(work, there))  # noqa: B023
        os.close(there)
        pipes.append((here, pid))
    out = []
    for here, pid in pipes:
        with open(here, "rb") as stream:
            told = stream.read()
        assert status_of(pid) == 0, "a process that tries stops has failed"
        out.append(pickle.loads(told))
    return out


def _told(work: Callable[[], object], there: int) -> int:
    with open(there, "wb") as stream:
        pickle.dump(work(), stream)
    return 0


def load_what_it_loads(work: Callable[[], int], log: Path) -> None:
    """Do the work in a fork, and load here what it has loaded there and in forks of its own, so that later forks need not."""
    names = log.with_name("modules")
    os.environ[LOADED] = str(names)
    status = forked(work, log)
    del os.environ[LOADED]
    assert status == 0, log.read_text()
    for name in dict.fromkeys(names.read_text().splitlines()):
        if name not in sys.modules and not name.startswith("__"):
            with contextlib.suppress(Exception):  # what makes modules as it goes
                importlib.import_module(name)
