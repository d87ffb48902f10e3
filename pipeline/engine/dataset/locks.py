"""Locks between runs: advisory locks (flock) of empty files, opened without following links or truncating anything."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from pipeline.errors import UserError

REFUSED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


class Lock:
    """An open lock file; closing it, or dying, lets go."""

    def __init__(self, path: Path, handle: int) -> None:
        self.path, self.handle = path, handle

    def take(self, alone: bool, waiting: Callable[[], None] | None = None) -> None:
        """Take it, alone or shared with others; where others hold it, call `waiting` and wait."""
        if not self.try_to_take(alone):
            if waiting is not None:
                waiting()
            fcntl.flock(self.handle, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)

    def try_to_take(self, alone: bool) -> bool:
        """Take it unless others hold it; returns whether it was taken. Raises UserError where there are no locks."""
        try:
            fcntl.flock(self.handle, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno not in REFUSED:
                raise
            fault = f"this file system has no locks ({error.strerror}), so that two runs could make one version"
            raise UserError(self.path, fault, "choose a DATASET= on another file system") from error
        return True


@contextlib.contextmanager
def open_lock(path: Path, new: bool = True) -> Iterator[Lock]:
    """Open a lock file, made where there is none (not `new`: FileNotFoundError). Raises UserError where it is no plain file."""
    flags = os.O_RDWR | (os.O_CREAT if new else 0) | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
    try:
        handle = os.open(path, flags, 0o666)
    except OSError as error:
        if error.errno == errno.ENOENT and not new:
            raise
        if error.errno in (errno.ELOOP, errno.EMLINK, errno.EISDIR, errno.ENXIO):
            raise UserError(path, "is no plain file, as a lock is", "remove it") from error
        raise UserError(path, f"cannot be opened ({error.strerror})", "check its permissions") from error
    try:
        yield Lock(path, handle)
    finally:
        os.close(handle)
