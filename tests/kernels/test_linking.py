"""A kernel holds its own copies of what it calls: its results do not hang on what else the process compiled or loaded."""

from __future__ import annotations

import llvmlite.binding as llvm
import numpy as np
import pytest

from pipeline.kernels import linking, storage
from pipeline.kernels.compiling import kernel


@pytest.mark.parametrize("installed", [True, False])
def test_called_kernels_are_local_to_their_caller(monkeypatch, installed) -> None:
    """numba.core.codegen: JITCodeLibrary._optimize_final_module, _final_module"""
    monkeypatch.setattr(storage, "place", lambda: None)
    if not installed:
        monkeypatch.setattr(linking.JITCodeLibrary, "_optimize_final_module", linking._optimise)

    @kernel
    def step(x):
        return np.sin(x) * np.exp(-x) + np.sqrt(x * x + 1.0)

    @kernel
    def four(x):
        return step(step(step(step(x))))

    @kernel
    def long_one(x):
        """Too long to be inlined wherever it is called."""
        return four(four(x)) + four(four(x + 2.0)) * four(four(x + 3.0))

    @kernel
    def caller(x):
        return long_one(x) + long_one(x + 1.0) * long_one(x * 2.0) - long_one(x / 3.0)

    caller(0.5)
    library = next(iter(caller.overloads.values())).library
    found = {f.name: f.linkage for f in llvm.parse_assembly(library.get_llvm_str()).functions if not f.is_declaration}
    copies = {linkage for name, linkage in found.items() if "long_one" in name}
    assert copies == {llvm.Linkage.internal if installed else llvm.Linkage.linkonce_odr}


def test_reference_counts_keep_their_names_and_declarations_stay() -> None:
    module = llvm.parse_assembly(
        "define linkonce_odr void @NRT_incref() { ret void }\ndefine linkonce_odr void @taken() { ret void }\n"
        "define void @own() { call void @taken() call void @NRT_incref() call void @elsewhere() ret void }\n"
        "declare void @elsewhere()\n"
    )
    linking.make_copies_local(module)
    kinds = {f.name: f.linkage for f in module.functions}
    assert kinds == {
        "NRT_incref": llvm.Linkage.linkonce_odr,
        "taken": llvm.Linkage.internal,
        "own": llvm.Linkage.external,
        "elsewhere": llvm.Linkage.external,
    }
