"""Machine code is made when somebody asks for a function's address, not for every kernel that others have copied into theirs.

numba makes the machine code of each library that it finishes. A kernel that only other kernels call never runs from there: its
callers take over its optimised LLVM code (`linking`) and make machine code of that themselves.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary, JITCPUCodegen

_make: Any = JITCodeLibrary._finalize_final_module
_address: Any = JITCodeLibrary.get_pointer_to_function
_with_machine_code: Any = JITCodeLibrary.serialize_using_object_code
_set_environment: Any = JITCPUCodegen.set_env
_environments: dict[str, Any] = {}  # constants of kernels, by the name of the pointer to them in code that is not made yet


def made(library: Any) -> bool:
    """Tell whether a library of numba's has machine code.

    Args:
        library: finished, of this process's target.

    Returns:
        False while nobody has asked for an address of it.
    """
    return not getattr(library, "_to_be_made", False)


def _postpone(library: Any) -> None:
    if library._shared_module is not None:  # loaded from disk, machine code and all
        _make(library)
    else:
        library._to_be_made = library._finalized = True
        library._finalize_dynamic_globals()


def _address_of(library: Any, name: str) -> int:
    library._ensure_finalized()
    if not made(library) and any(function.name == name for function in library.get_defined_functions()):
        library._to_be_made = False
        _make(library)
        for variable in library._final_module.global_variables:
            if variable.name in _environments:
                _set_environment(library._codegen, variable.name, _environments.pop(variable.name))
    return int(_address(library, name)) if made(library) else 0


def _serialize(library: Any) -> Any:
    library._ensure_finalized()
    return _with_machine_code(library) if made(library) else library.serialize_using_bitcode()


def _environment(codegen: Any, name: str, environment: Any) -> None:
    if codegen._engine.is_symbol_defined(name):
        _set_environment(codegen, name, environment)
    else:
        _environments[name] = environment


def install() -> None:
    """Have numba do so with everything that this process compiles from now on."""
    JITCodeLibrary._finalize_final_module = _postpone  # type: ignore[method-assign]
    JITCodeLibrary.get_pointer_to_function = _address_of  # type: ignore[method-assign]
    JITCodeLibrary.serialize_using_object_code = _serialize  # type: ignore[method-assign]
    JITCPUCodegen.set_env = _environment  # type: ignore[method-assign]
