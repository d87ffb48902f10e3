"""Where compiled kernels are kept: numba looks only at a function's own file and misses changes in kernels it calls."""

from __future__ import annotations

import functools
import hashlib
import os
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("pipeline/kernels", "pipeline/rig", "stages/olat")  # kernels that call one another across files


@functools.cache
def sources() -> str:
    """Digest of the sources of these kernels."""
    digest = hashlib.sha256()
    for name in FOLDERS:
        for path in sorted((ROOT / name).rglob("*.py")):
            digest.update(path.read_bytes())  # all of them: kernels take constants and record layouts from plain modules too
    return digest.hexdigest()[:12]


@functools.cache
def folder() -> Path | None:
    """The folder named after the sources of these kernels, in the user's cache where the package cannot be written.

    None where NUMBA_CACHE_DIR says where, or neither can be written.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return None
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for place in (Path(__file__).parent / "__pycache__", home / "polarfield"):
        target = place / f"kernels-{sources()}"
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(target, os.W_OK):
            return target
    return None


def keep_fresh() -> None:
    """Have numba keep these folders' kernels, and no others, in `folder()`. Call before the kernels are defined."""
    from numba.core import caching

    if any(c.__name__ == "_FreshLocator" for c in caching.CacheImpl._locator_classes):
        return

    class _FreshLocator(caching.UserProvidedCacheLocator):
        """Kernels of `FOLDERS` only: others keep numba's own place, whatever is imported first."""

        def __init__(self, py_func: Any, py_file: str) -> None:
            super().__init__(py_func, py_file)
            self._cache_path = os.path.join(str(folder()), self.get_suitable_cache_subpath(py_file))

        @classmethod
        def from_function(cls, py_func: Any, py_file: str) -> Any:
            """None for a kernel that is another's."""
            ours = any(Path(py_file).resolve().is_relative_to(ROOT / name) for name in FOLDERS)
            if not ours or folder() is None:
                return None
            return super(caching.UserProvidedCacheLocator, cls).from_function(py_func, py_file)

    caching.CacheImpl._locator_classes.insert(0, _FreshLocator)
