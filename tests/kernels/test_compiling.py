"""`kernel`: numba's options as they are, and code kept only where its sources are sure."""

from __future__ import annotations

import importlib.util
import json
import os
import time

import numba
import numpy as np
import pytest

from pipeline.kernels import compiling, freshness, on_demand, storage
from pipeline.kernels.compiling import compile_seconds, kernel
from tests.kernels.conftest import finished

SOURCE = """
from numba import njit
from pipeline.kernels.compiling import kernel

@kernel
def twice(x):
    return 2 * x

@njit(cache=True)
def thrice(x):
    return 3 * x
"""
SHOW = """
import json, sys
sys.path.insert(0, ".")
import doubling
values = doubling.twice(2), doubling.thrice(2)
ours, numbas = doubling.twice.stats, doubling.thrice.stats
print(json.dumps([values, ours.cache_path, numbas.cache_path, sum(ours.cache_hits.values())]))
"""


def _module(path, text=SOURCE):
    path.write_text(text)
    before = time.time() - 3600  # a source older than this process
    os.utime(path, (before, before))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_other_projects_kernels_stay_where_numba_puts_them(tmp_path, monkeypatch) -> None:
    before = numba.config.CACHE_LOCATOR_CLASSES
    module = _module(tmp_path / "doubling.py")
    assert module.twice.stats.cache_path == str(storage.place())
    assert module.thrice.stats.cache_path != str(storage.place())
    assert before == numba.config.CACHE_LOCATOR_CLASSES


def test_options_reach_numba_as_they_are() -> None:
    @kernel(nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
    def some(x):
        return x

    @kernel(allocates=False)
    def lean(x):
        return x

    @kernel
    def plain(x):
        return x

    always = {"nopython": True, "boundscheck": None, "no_cfunc_wrapper": True}
    assert some.targetoptions == {"nogil": True, "fastmath": {"contract", "nsz"}, "error_model": "numpy", **always}
    assert lean.targetoptions == {"_nrt": False, **always}
    assert plain.targetoptions == always


def test_a_kernel_called_by_another_has_no_machine_code_of_its_own_until_python_calls_it(tmp_path, monkeypatch) -> None:
    """numba: Dispatcher.get_call_template and get_overload; JITCodeLibrary._finalize_final_module, set_env"""
    monkeypatch.setattr(storage, "place", lambda: None)
    text = "from pipeline.kernels.compiling import kernel\n\n"
    text += "@kernel\ndef part(x):\n    if x < 0:\n        raise ValueError('below', x)\n    return 2 * x\n\n"
    text += "@kernel\ndef whole(x):\n    return part(x) + 1\n"
    module = _module(tmp_path / "called.py", text)
    assert module.whole(3) == 7
    inner = next(iter(module.part.twin().overloads.values())).library
    assert not on_demand.made(inner) and on_demand.made(next(iter(module.whole.overloads.values())).library)
    assert not module.part.overloads
    with pytest.raises(ValueError, match="below"):
        module.whole(-1)
    assert module.part(3) == 6
    assert inner.get_pointer_to_function(next(iter(module.part.twin().overloads.values())).fndesc.llvm_func_name) > 0
    assert on_demand.made(inner)


@pytest.mark.slow
def test_another_process_takes_over_what_kernels_were_compiled_from(checkout) -> None:
    text = "from pipeline.kernels.compiling import kernel\n\n@kernel\ndef part(x):\n    return 2 * x\n\n"
    checkout.write("part.py", text)
    for name in ("one", "other"):
        checkout.write(f"{name}.py", f"from part import part\n{text.replace('part', name).replace('2 * x', 'part(x) + 1')}")
    show = "import sys\nsys.path.insert(0, '.')\nfrom {0} import {0}, part\n"
    show += "print({0}(2), sum(part.twin().stats.cache_hits.values()), sum({0}.stats.cache_hits.values()))"
    assert [checkout.run(show.format(name)) for name in ("one", "other", "one")] == ["5 0 0", "5 1 0", "5 0 1"]


@pytest.mark.slow
def test_a_kernel_that_makes_no_arrays_goes_without_numbas_runtime(monkeypatch) -> None:
    """`_nrt` is numba's own name for it: this fails when it is no longer heeded, and with the runtime come the counts."""
    monkeypatch.setattr(storage, "place", lambda: None)

    def largest(n):
        return np.arange(n).max()

    assert kernel(largest)(4) == 3
    with pytest.raises(numba.core.errors.NumbaError, match="Only accept returning of array passed"):
        kernel(largest, allocates=False)(4)


@pytest.mark.parametrize("again", ["@kernel\ndef twice(x):\n    return 4 * x", "kernel(twice.py_func, fastmath=True)"])
def test_two_kernels_of_one_name_in_a_file_are_refused(tmp_path, again) -> None:
    with pytest.raises(TypeError, match=r"doubling\.py:\d+: twice is a kernel already"):
        _module(tmp_path / "doubling.py", f"{SOURCE}\n{again}\n")


def test_what_is_compiled_after_an_edit_is_not_kept(tmp_path) -> None:
    module = _module(tmp_path / "doubling.py")
    assert freshness.settled(tmp_path / "doubling.py")
    os.utime(tmp_path / "doubling.py")  # saved anew while this process runs
    assert not freshness.settled(tmp_path / "doubling.py")
    assert kernel(module.twice.py_func).stats.cache_path is None
    to_come = time.time() + 3600  # another machine's clock
    os.utime(tmp_path / "doubling.py", (to_come, to_come))
    assert freshness.settled(tmp_path / "doubling.py")


def test_where_nothing_can_be_written_kernels_still_run(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(storage, "place", lambda: None)
    module = _module(tmp_path / "doubling.py")
    assert module.twice(3) == 6
    assert module.twice.stats.cache_path is None


def test_numba_without_its_hook_is_noticed(tmp_path, monkeypatch) -> None:
    """Were the setting ignored, kernels would go stale without a word."""
    monkeypatch.setattr(compiling, "_config", type("Ignored", (), {"CACHE_LOCATOR_CLASSES": ""}))
    with pytest.raises(RuntimeError, match="its rules changed"):
        _module(tmp_path / "doubling.py")


@pytest.mark.slow
def test_processes_that_compile_at_once_leave_whole_code(checkout) -> None:
    checkout.write("doubling.py", SOURCE)
    for process in [checkout.start(SHOW) for _ in range(4)]:
        values, ours, numbas, _ = json.loads(finished(process))
        assert values == [4, 6]
        assert (ours, numbas) == (str(checkout.code), str(checkout.root / "__pycache__"))
    assert json.loads(checkout.run(SHOW))[3] == 1
    assert not list(checkout.code.glob("*.tmp*"))


def test_time_spent_compiling_is_counted_and_calling_is_not(monkeypatch):
    monkeypatch.setattr(storage, "place", lambda: None)

    @kernel
    def twice(x):
        return 2 * x

    before = compile_seconds()
    twice(1.0)
    after = compile_seconds()
    twice(2.0)
    assert after > before
    assert compile_seconds() == after
