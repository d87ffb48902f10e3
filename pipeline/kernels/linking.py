"""Every kernel runs its own copies of the kernels that it calls, whatever else the process compiled or loaded.

numba links a called kernel into its caller as a weak symbol. What LLVM does not inline stays a function of that name in both
objects, optimised apart, with `fastmath` to other last bits; and the first that a process brings into memory serves all.
That is the called kernel's own code where it was just compiled, and the caller's copy where the caller came from disk: the
first run after an edit gave other results than the next (the gradient of the index of refraction, and so the trained scene).
Here such copies are made local to their caller before it is optimised.
"""

from __future__ import annotations

from typing import Any

from llvmlite.binding import Linkage
from numba.core.codegen import JITCodeLibrary

_SHARED = "NRT_"  # numba's reference counts: one code everywhere, and numba prunes them by these names
_optimise: Any = JITCodeLibrary._optimize_final_module


def make_copies_local(module: Any) -> None:
    """Make the functions that an LLVM module took over from other libraries its own.

    Args:
        module: llvmlite's, linked but not yet optimised; changed in place.
    """
    for function in module.functions:
        taken_over = not function.is_declaration and function.linkage == Linkage.linkonce_odr
        if taken_over and not function.name.startswith(_SHARED):
            function.linkage = Linkage.internal


def _optimise_with_local_copies(library: Any) -> None:
    make_copies_local(library._final_module)
    _optimise(library)


def install() -> None:
    """Have numba do so in everything that this process compiles from now on."""
    JITCodeLibrary._optimize_final_module = _optimise_with_local_copies  # type: ignore[method-assign]
