"""Which project files a kernel's file draws on, and one digest of them all. Does not load numba.

Imports are read from the sources, so nothing is run; what a source says is remembered by its content (`source_facts`), and the
digest of a dozen files takes a millisecond.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import sys
import time
from pathlib import Path

from pipeline import STARTED
from pipeline.kernels.source_facts import Import, read_facts, remember
from pipeline.kernels.storage import ROOT

UNRELATED = frozenset(
    "NUMBA_" + name
    for name in (
        "CACHE_DIR", "CACHE_LOCATOR_CLASSES", "DEBUG_CACHE", "DISABLE_JIT", "DISABLE_PERFORMANCE_WARNINGS", "NUM_THREADS",
        "THREADING_LAYER", "THREADING_LAYER_PRIORITY", "WARNINGS",
    )
)  # fmt: skip
"""numba's settings that leave machine code as it is."""


def digest(file: Path) -> str:
    """16 hexadecimal digits that stand for all that machine code of kernels in `file` depends on but the processor: the sources
    that it draws on, numba's settings in the environment, the versions of Python, numba, llvmlite and numpy."""
    options = (f"{k}={v}" for k, v in os.environ.items() if k.startswith("NUMBA_") and k not in UNRELATED)
    return _digest(_true(file), tuple(sorted(options)))


def settled(file: Path) -> bool:
    """Whether no source that `file` draws on was changed since this process began.

    If one was, this process may run the old one while the file is the new one: what it compiles must not be kept under the new
    one's digest.
    """
    now = time.time()  # a time to come says nothing: it is from another clock
    return not any(STARTED < os.stat(source).st_mtime <= now for source in sources(_true(file)))


@functools.cache
def sources(file: Path) -> tuple[Path, ...]:
    """The project files that `file` draws on, directly or not, itself among them, sorted.

    A file draws on the modules that it imports, anywhere but under TYPE_CHECKING; on a package's `__init__` where it takes a
    name from it that is not a module.
    """
    found, ends = {file}, [file]
    while ends:
        here = ends.pop()
        reached = {target for one in read_facts(here).imports if (target := _resolved(here, one)) is not None}
        ends += reached - found
        found |= reached
    remember()
    return tuple(sorted(found))


@functools.cache
def dotted(file: Path) -> str:
    """The name by which `file` is imported, the same in every checkout."""
    file = _true(file)
    return ".".join(file.relative_to(_base(file)).with_suffix("").parts)


@functools.cache
def _true(file: Path) -> Path:
    return file.resolve()


@functools.cache
def _digest(file: Path, options: tuple[str, ...]) -> str:
    whole = hashlib.sha256("\0".join((*options, sys.version, *_versions())).encode())
    for name, said in sorted((dotted(source), read_facts(source).digest) for source in sources(file)):
        whole.update(f"\0{name}\0{said}".encode())
    return whole.hexdigest()[:16]


@functools.cache
def _versions() -> tuple[str, ...]:
    """Of the libraries that machine code depends on, without importing them."""
    origins = [spec.origin for name in ("numba", "llvmlite", "numpy") if (spec := importlib.util.find_spec(name)) is not None]
    files = [Path(origin).with_name(name) for origin in origins if origin for name in ("_version.py", "version.py")]
    return tuple(file.read_text() for file in files if file.is_file())


@functools.cache
def _base(file: Path) -> Path:
    """The folder from which the packages of `file` are imported."""
    if file.is_relative_to(ROOT):
        return ROOT
    base = file.parent
    while (base / "__init__.py").is_file():
        base = base.parent
    return base


def _resolved(file: Path, one: Import) -> Path | None:
    """The project file that an import in `file` reaches; None for others' modules."""
    if one.level:
        bases: tuple[Path, ...] = (file.parents[one.level - 1],)
    else:
        top = one.module.partition(".")[0]
        ours = top in (dotted(file).partition(".")[0], __name__.partition(".")[0])
        bases = tuple(base for base in (_base(file), ROOT) if _holds(base, top) and (ours or not _holds(base, "numba")))
    for base in bases:
        module = _file(base, one.module)
        within = _file(base, f"{one.module}.{one.name}") if one.name and (module is None or module.stem == "__init__") else None
        if found := within or module:
            return found
    return None


@functools.cache
def _holds(base: Path, top: str) -> bool:
    """Whether a module or package lies in a folder. Where numba does, everyone's do."""
    return (base / top).is_dir() or (base / f"{top}.py").is_file()


@functools.cache
def _file(base: Path, module: str) -> Path | None:
    """The source of a module whose name (perhaps none: the package `base` itself) counts from a folder."""
    path = os.path.join(base, *module.strip(".").split("."))
    for candidate in (f"{path}.py", os.path.join(path, "__init__.py")):
        if os.path.isfile(candidate):
            return Path(candidate)
    return None
