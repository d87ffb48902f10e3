"""What the kernels use of numba's internals, one test each: a numba that changes them fails here first."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit, types

from pipeline.kernels import native, scratch, simd


@njit
def _stack_sum(n):
    a, b = scratch.vector(3), scratch.matrix(2, 3)
    for i in range(3):
        a[i] = i + n
        b[0, i], b[1, i] = 10.0 * i, 100.0
    return a.sum() + b[0].sum() + b[1, 2], b.shape


def test_arrays_on_the_stack() -> None:
    """numba.core.cgutils, numba.np.arrayobj"""
    assert _stack_sum(1) == (6 + 30 + 100, (2, 3))


def test_rows_of_a_workspace() -> None:
    """numba.np.arrayobj"""

    @njit
    def fill(flat):
        table = scratch.folded(flat, 2, 3)
        for i in range(2):
            for j in range(3):
                table[i, j] = 10 * i + j

    flat = np.zeros(7)
    fill(flat)
    assert flat.tolist() == [0, 1, 2, 10, 11, 12, 0]


def test_operators_of_lanes() -> None:
    """numba.extending: types, operators and intrinsics of our own; a context's make_array"""

    @njit
    def compute(out):
        x = simd.load(out, 0)
        y = (x + 1) * 2 - x / 4
        y += x
        simd.store(out, 0, simd.select((x > 3) & (x <= 9), y, 0))

    out = np.arange(simd.LANES, dtype=np.float32)
    expected = np.where((out > 3) & (out <= 9), (out + 1) * 2 - out / 4 + out, 0).astype(np.float32)
    compute(out)
    np.testing.assert_array_equal(out, expected)


def test_tickets_are_drawn_once() -> None:
    """LLVM's atomic addition"""

    @njit
    def draw(counters):
        return simd.take_ticket(counters, 1), simd.take_ticket(counters, 1)

    assert draw(np.zeros(2, np.int64)) == (0, 1)


@pytest.mark.parametrize("kind", ["symbol", "object file"])
def test_an_object_file_of_a_function(kind) -> None:
    """numba.core.compiler.compile_extra, numba.core.registry.cpu_target, a library's serialize_using_object_code"""

    def nothing(n):
        pass

    symbol, code = native.machine_code(nothing, (types.int64,))
    assert symbol.encode() in code if kind == "symbol" else len(code) > 100
