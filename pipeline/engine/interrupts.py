"""Signals that end a run: heard once, passed on to the stage, which has a few seconds to keep what it can."""

from __future__ import annotations

import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
GRACE_S = 4.0  # a checkpoint takes well under a second; a library that hears no signal is ended after this


class Interrupted(KeyboardInterrupt):
    """A signal that ends the run; `status` is what the process exits with."""

    def __init__(self, number: int) -> None:
        self.status = 128 + number
        super().__init__(number)


@contextmanager
def interruptible() -> Iterator[None]:
    """Within it, the first signal of ENDING raises Interrupted and no later one does; one that was ignored stays so (nohup)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = [s for s in ENDING if signal.getsignal(s) not in (signal.SIG_IGN, None)]

    def end(number: int, frame: FrameType | None) -> None:
        for s in heard:
            signal.signal(s, signal.SIG_IGN)
        raise Interrupted(number)

    before = {s: signal.signal(s, end) for s in heard}
    try:
        yield
    finally:
        for s, handler in before.items():
            signal.signal(s, handler)


@contextmanager
def unheard() -> Iterator[None]:
    """Signals of ENDING wait until its end: one that came while a process is begun would be lost in what runs about a fork."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def wait_for(child: subprocess.Popen) -> int:
    """The exit status of a child; an Interrupted here ends the child first: asked by SIGTERM, then by SIGKILL."""
    try:
        return child.wait()
    except KeyboardInterrupt:
        child.terminate()
        try:
            child.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        raise


def in_child() -> None:
    """Before a child's program starts: it dies with its parent (Linux), and hears Ctrl-C through it alone."""
    import ctypes

    pr_set_pdeathsig = 1
    if prctl := getattr(ctypes.CDLL(None), "prctl", None):
        prctl(pr_set_pdeathsig, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
