"""Kernels' machine code kept as object files, so that a process runs them without loading numba.

To import numba, its types and one cached kernel takes half a second of processor time. A kernel that takes numbers and
pointers, allocates nothing and raises nothing needs none of that: llvmlite puts its object file into memory and ctypes calls
it, which releases the interpreter's lock meanwhile.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.kernels import freshness, storage

Kernel = Callable[..., None]
KINDS = {"int64": ctypes.c_int64, "pointer": ctypes.c_void_p}
UNREACHED = ("NRT_MemInfo_call_dtor",)
"""Symbols of numba's runtime that kernels without allocations reference but never call: the destructor of an array."""
_loaded: dict[str, tuple[Kernel, Any]] = {}
_loading = threading.Lock()


def kernel(name: str, source: Path, arguments: tuple[str, ...], build: Callable[[], tuple[str, bytes]]) -> Kernel:
    """Load a kernel from its object file, or make that first.

    Args:
        name: the kernel's.
        source: the file that defines it.
        arguments: their kinds, "int64" or "pointer".
        build: compiles it; returns its symbol and object file (`machine_code`).

    Returns:
        A function of those arguments that returns nothing and releases the interpreter's lock.
    """
    with _loading:  # cameras' readers ask at once
        if name not in _loaded:
            place = _place(name, source)
            found = _read(place) if place is not None else None
            if found is None:
                found = build()
                if place is not None:
                    _keep(place, *found)
            _loaded[name] = _linked(*found, arguments)
        return _loaded[name][0]


def compiled(name: str, source: Path) -> bool:
    """Say whether a kernel was compiled before, so that it runs without numba.

    Args:
        name: the kernel's.
        source: the file that defines it.

    Returns:
        True where it is loaded, or its object file is up to date with its sources.
    """
    place = _place(name, source)
    return name in _loaded or (place is not None and place.is_file())


def machine_code(function: Callable[..., None], arguments: tuple[Any, ...]) -> tuple[str, bytes]:
    """Compile a function to an object file that stands alone.

    Args:
        function: takes numbers and pointers, allocates nothing, raises nothing, returns nothing.
        arguments: their numba types.

    Returns:
        Its symbol, and the object file.

    Raises:
        TypeError: it needs numba's runtime.
    """
    import llvmlite.binding as llvm
    from numba.core import compiler, registry, types

    flags: Any = compiler.Flags()
    flags.no_cpython_wrapper = flags.no_cfunc_wrapper = flags.nrt = True
    flags.error_model = "numpy"
    typing, target = registry.cpu_target.typing_context, registry.cpu_target.target_context
    found = compiler.compile_extra(typing, target, function, arguments, types.none, flags, locals={})
    symbol = found.fndesc.llvm_func_name
    process, module = ctypes.CDLL(None), llvm.parse_assembly(found.library.get_llvm_str())
    foreign = {f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm.")}
    if missing := [name for name in sorted(foreign.difference(UNREACHED)) if not hasattr(process, name)]:
        raise TypeError(f"{symbol} needs numba's runtime: {', '.join(missing)}")
    found.library.get_pointer_to_function(symbol)  # until it is asked for, nothing is compiled
    _, _, (code, _) = found.library.serialize_using_object_code()
    return symbol, bytes(code)


def _place(name: str, source: Path) -> Path | None:
    """Where the object file for these sources and this processor is kept; None where it cannot be, or must not."""
    import llvmlite.binding as llvm

    folder = storage.place()
    if folder is None or not freshness.settled(source):
        return None
    file, digest = freshness.dotted(source), freshness.digest(source)
    storage.claim(folder, file, digest)
    processor = "\0".join((llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()))
    return folder / f"{name}-{storage.label(file, digest)}.{hashlib.sha256(processor.encode()).hexdigest()[:12]}.o"


def _read(place: Path) -> tuple[str, bytes] | None:
    """Symbol and object file, None where there is no whole one."""
    try:
        symbol, digest, code = place.read_bytes().split(b"\n", 2)
    except (OSError, ValueError):
        return None
    return (symbol.decode(), code) if hashlib.sha256(code).hexdigest().encode() == digest else None


def _keep(place: Path, symbol: str, code: bytes) -> None:
    """Write the object file in one step, so that no other process reads half of one."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place.parent) as aside:
            file = Path(aside) / place.name  # with the permissions of the user's umask, unlike a temporary file
            file.write_bytes(b"\n".join((symbol.encode(), hashlib.sha256(code).hexdigest().encode(), code)))
            os.replace(file, place)
    except OSError:
        return  # it is compiled again next time


def _linked(symbol: str, code: bytes, arguments: tuple[str, ...]) -> tuple[Kernel, Any]:
    """The function of an object file, and what keeps its memory; numba's calling convention for a function without result."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    unreached = ctypes.cast(ctypes.CDLL(None).abort, ctypes.c_void_p).value
    for name in UNREACHED:
        if llvm.address_of_symbol(name) is None:
            llvm.add_symbol(name, unreached)
    target = llvm.Target.from_triple(llvm.get_process_triple())
    reloc = "static" if target.name.startswith("x86") else "default"  # as numba compiles for the machine it runs on
    machine = target.create_target_machine(opt=3, reloc=reloc, codemodel="jitdefault", jit=True)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    function = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, *(KINDS[kind] for kind in arguments))
    entry = function(engine.get_function_address(symbol))

    def call(*values: int) -> None:
        result, fault = ctypes.c_void_p(), ctypes.c_void_p()
        status = entry(ctypes.addressof(result), ctypes.addressof(fault), *values)
        if status:
            raise RuntimeError(f"{symbol} failed ({status})")

    return call, engine
