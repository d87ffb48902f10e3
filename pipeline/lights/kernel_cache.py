"""Where compiled kernels are kept: numba looks only at a function's own file and misses changes in kernels it calls."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("pipeline/lights", "stages/olat")  # kernels that call one another across files


def keep_fresh() -> None:
    """Point numba's cache to a folder named after the kernels' sources, unless NUMBA_CACHE_DIR says where.

    Call before the kernels are defined. Where the folder cannot be written numba's own choice stays.
    """
    import numba

    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    digest = hashlib.sha256()
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).glob("*.py")):
            source = path.read_bytes()
            if b"@njit" in source:
                digest.update(source)
    target = Path(__file__).parent / "__pycache__" / f"kernels-{digest.hexdigest()[:12]}"
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if os.access(target, os.W_OK):
        numba.config.CACHE_DIR = str(target)  # type: ignore[attr-defined]
