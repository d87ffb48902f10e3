"""`kernel`: numba.njit, kept on disk by the digest of all sources that it draws on. Importing this loads numba."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import contextmanager, nullcontext
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import event

from pipeline.kernels import freshness, linking, on_demand, storage

linking.install()
on_demand.install()

_NUMBAS_OWN = "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"
_FROM_PYTHON: dict[str, Any] = {"no_cfunc_wrapper": True}  # which is for calls from C
_FROM_KERNELS: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_config: Any = numba.config  # its settings are made at run time
_here = threading.local()  # .function: the kernel that this thread is decorating
_decorating = threading.Lock()
_compiling = event.TimingListener()  # by no thread but one at a time: numba compiles under a lock
event.register("numba:compile", _compiling)
_made: dict[tuple[str, str], tuple[int, dict[str, Any]]] = {}


def kernel(function: Callable[..., Any] | None = None, *, allocates: bool = True, **options: Any) -> Any:
    """Compile a function with numba at its first call, or load what was compiled from the same sources before.

    Args:
        function: what to compile; None: return a decorator.
        allocates: False promises that the kernel makes no arrays, and compiles it without reference counts: an atomic count for
            every view of an array, shared by the threads, took two fifths of the rasteriser's backward pass.
        options: numba.njit's, `cache` aside. Nothing is set unless it is said.

    Returns:
        The compiled function, as numba.njit has it, or the decorator.

    Raises:
        TypeError: a second kernel of the same qualified name in one file, or other options for the same function: their code
            would be kept under one name.
        RuntimeError: numba keeps the code elsewhere than it was asked to.
    """
    if function is None:
        return lambda function: kernel(function, allocates=allocates, **options)
    if not allocates:
        options["_nrt"] = False
    file = Path(function.__code__.co_filename)
    folder = storage.place()
    kept = folder is not None and file.is_file() and freshness.settled(file)
    this = function.__code__.co_firstlineno, options
    if kept and _made.setdefault((str(file), function.__qualname__), this) != this:
        raise TypeError(f"{file}:{this[0]}: {function.__qualname__} is a kernel already, or one with other options: rename one")

    def made(called_by: dict[str, Any], kind: str = "") -> Any:
        with _located(function, kind) if kept else nullcontext():
            return numba.njit(cache=kept, **called_by, **options)(function)

    compiled = made(_FROM_PYTHON)
    if kept and hasattr(compiled, "stats") and compiled.stats.cache_path != str(folder):  # with NUMBA_DISABLE_JIT: the function
        raise RuntimeError(f"numba keeps {function.__qualname__} in {compiled.stats.cache_path}: its rules changed")
    return _with_twin(compiled, lambda: made(_FROM_KERNELS, "inner-"))


def _with_twin(compiled: Any, make: Callable[[], Any]) -> Any:
    """Have other kernels call a kernel's twin, `compiled.twin()`: the same, without the wrapper that only Python needs."""
    if hasattr(compiled, "get_call_template"):  # with NUMBA_DISABLE_JIT it is the function
        compiled.twin = twin = cache(make)
        compiled.get_call_template = lambda arguments, named: twin().get_call_template(arguments, named)
        compiled.get_overload = lambda signature: twin().get_overload(signature)
    return compiled


def compile_seconds() -> float:
    """What this process has spent compiling kernels so far (s); loading kept ones is no part of it."""
    return float(_compiling.duration) if _compiling.done else 0.0


@contextmanager
def _located(function: Callable[..., Any], kind: str = "") -> Any:
    """Have numba ask `Locator` where the code of `function` lies (its setting NUMBA_CACHE_LOCATOR_CLASSES, for this call)."""
    with _decorating:
        before, _here.function, _here.kind = _config.CACHE_LOCATOR_CLASSES, function, kind
        _config.CACHE_LOCATOR_CLASSES = f"{__name__}.{Locator.__name__},{before or _NUMBAS_OWN}"
        try:
            yield
        finally:
            _config.CACHE_LOCATOR_CLASSES, _here.function = before, None


class Locator:
    """Where numba keeps a kernel's code: the interface of its cache locators."""

    def __init__(self, file: Path, folder: Path, kind: str) -> None:  # kind: of the twin, its mark in the file's name
        self._py_file = str(file)  # numba names it in a warning
        self.kind = kind
        self.folder, self.name, self.digest = folder, freshness.dotted(file), freshness.digest(file)
        storage.claim(folder, self.name, self.digest)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Locator | None:
        """The locator of a kernel; None, for numba to ask the next class, of any other function."""
        folder = storage.place()
        ours = py_func is getattr(_here, "function", None)
        return cls(Path(py_file), folder, _here.kind) if ours and folder is not None else None

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        self.folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self.folder)

    def get_source_stamp(self) -> str:
        """What must be equal for kept code to be right."""
        return self.digest

    def get_disambiguator(self) -> str:
        """Part of the file's name: with the digest in it, no process ever writes over another state's code."""
        return self.kind + storage.label(self.name, self.digest)
