"""Work in a fork of a process that has loaded everything."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

FAILED = 99  # exit status of work that ended in an exception


def end_as(work: Callable[[], int], log: Path) -> NoReturn:
    """In a fork: do the work, what it says going to a file, and end the process with its status."""
    status = FAILED
    try:
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
        os._exit(status)
