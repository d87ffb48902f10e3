"""Which machines are at work on a dataset, so that two that do not see each other's locks never both make one version.

Some file systems grant each machine locks of its own: NFS mounted with `nolock` or `local_lock`, Lustre with `localflock`,
sshfs and others through FUSE. So every run leaves a record in `.work/machines`, locked and with a number that goes up as long
as the run lives. A record of another machine whose lock can be had belongs to a run that has died, or locks do not reach from
there to here: which, the number tells.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

from pipeline.engine.dataset.documents import small_file
from pipeline.engine.dataset.links import refuse_links
from pipeline.engine.dataset.locks import Lock, open_lock
from pipeline.errors import UserError

FOLDER = "machines"
BEAT_S = 5.0  # between two numbers: a file of twenty bytes, flushed
SILENT_S = 45.0
"""Without a new number for so long a run is dead: longer than a library keeps Python's other threads from running, and than NFS
clients keep a file's attributes by default (30 s for folders; contents are asked for again at every open)."""
LOOK_S = 0.5
BOOT = Path("/proc/sys/kernel/random/boot_id")


@cache
def machine() -> str:
    """What tells the running system of this machine from all others: Linux's number of the boot (shared by its containers, as
    locks are), elsewhere the host's name and hardware address."""
    try:
        return BOOT.read_text().strip().replace("-", "")
    except OSError:
        import uuid

        return f"{socket.gethostname()}.{uuid.getnode():x}".replace("-", "_").replace("/", "_")


@contextlib.contextmanager
def present(root: Path, say: Callable[[str], None] = print) -> Iterator[None]:
    """Be at work on the dataset at `root`, whose `.work` is there.

    Args:
        root: the dataset's folder.
        say: is told, in words, why it takes a while where that is so.

    Raises:
        UserError: a run on another machine is at work, and locks do not reach from there to here.
    """
    folder = root / ".work" / FOLDER
    refuse_links(root, folder)
    folder.mkdir(exist_ok=True)
    with _record(folder) as lock:
        BEATS.add(lock.handle)
        try:
            # One's own is there already: of two that come at once, each sees the other.
            _refuse_unreached([path for path in folder.iterdir() if path != lock.path], root, say)
            yield
        finally:
            BEATS.drop(lock.handle)
            with contextlib.suppress(OSError):
                lock.path.unlink()


@contextlib.contextmanager
def _record(folder: Path) -> Iterator[Lock]:
    """A locked record of this run's own."""
    while True:
        path = folder / f"{machine()}-{os.getpid()}-{secrets.token_hex(4)}"
        with open_lock(path) as lock:
            lock.take(alone=True)
            if _is(path, lock.handle):  # else another took it, not yet locked, for one of a dead run
                fcntl.fcntl(lock.handle, fcntl.F_SETFL, 0)  # it is written over, not added to
                _write(lock.handle, 0)
                yield lock
                return


def _is(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(handle))
    except FileNotFoundError:
        return False


def _write(handle: int, number: int) -> None:
    os.pwrite(handle, f"{socket.gethostname()} {number:010}\n".encode(), 0)


class _Beats:
    """The numbers of all records of this process: a batch works on many datasets."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew: a fork has neither the thread nor the records of the process that it was."""
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._numbers: dict[int, int] = {}

    def add(self, handle: int) -> None:
        """Have this record's number go up from here on."""
        with self._lock:
            if not self._numbers:
                self._ended = threading.Event()
                threading.Thread(target=self._beat, args=(self._ended,), daemon=True).start()
            self._numbers[handle] = 0

    def drop(self, handle: int) -> None:
        """Let it stand; from here on the handle may be closed."""
        with self._lock:
            self._numbers.pop(handle, None)
            if not self._numbers:
                self._ended.set()

    def _beat(self, ended: threading.Event) -> None:
        while not ended.wait(BEAT_S):
            for handle in list(self._numbers):
                with self._lock:
                    if ended.is_set() or handle not in self._numbers:
                        continue
                    self._numbers[handle] += 1
                    with contextlib.suppress(OSError):
                        _write(handle, self._numbers[handle])
                        os.fsync(handle)  # a network file system keeps what is written for a while


BEATS = _Beats()
os.register_at_fork(after_in_child=BEATS.forget)


def _refuse_unreached(records: Iterable[Path], root: Path, say: Callable[[str], None]) -> None:
    """Raise UserError where a run left one of these that lives, though its lock can be had here; drop those of dead runs."""
    free = [path for path in records if _can_be_had(path)]
    here = [path for path in free if path.name.startswith(f"{machine()}-")]  # of this machine, whose locks are seen: dead
    watched = {path: small_file(path) for path in free if path not in here}
    if watched:
        name = _name_of(next(iter(watched.values())))
        say(f"a run on another machine{name} was at work here; looking whether it still is ({SILENT_S:.0f} s)")
    began = time.monotonic()
    while watched and time.monotonic() - began < SILENT_S:
        time.sleep(LOOK_S)
        for path, first in list(watched.items()):
            if not _can_be_had(path):  # it has ended, or has only now been locked
                del watched[path]
            elif (now := small_file(path)) != first:
                fault = f"a run on another machine{_name_of(now)} is at work on it, and the locks of this file system do not "
                remedy = "wait until it has ended, or mount the file system with locks (flock) that all machines share"
                raise UserError(root, f"{fault}reach from there to here", remedy)
    for path in (*here, *watched):
        with contextlib.suppress(OSError):
            path.unlink()


def _can_be_had(path: Path) -> bool:
    """Whether a record is there and nobody is seen to hold its lock."""
    try:
        with open_lock(path, new=False) as lock:
            return lock.try_to_take(alone=True) and _is(path, lock.handle)
    except FileNotFoundError:
        return False


def _name_of(record: bytes | None) -> str:
    words = (record or b"").decode(errors="replace").split()
    return f" ({words[0][:64]})" if words and words[0].isprintable() else ""
