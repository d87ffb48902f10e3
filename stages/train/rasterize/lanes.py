"""What numba lacks for these kernels: horizontal sums over one row of a tile, and a counter shared between threads.

numba does not vectorise short reductions and has no atomics on the CPU; both are one LLVM instruction.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 16
"""Pixels handled together: the width of a tile; one AVX-512 register of float32, two AVX2 ones."""


def _reduction(name: str, start: float | None) -> Any:
    """Intrinsic (buffer float32[:], offset uint64) -> float32 that folds LANES values with an LLVM vector reduction."""

    @intrinsic
    def fold(typingctx: Any, buffer: Any, offset: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            row = ir.VectorType(ir.FloatType(), LANES)
            pointer = builder.bitcast(builder.gep(data, [arguments[1]]), row.as_pointer())
            values = builder.load(pointer, align=4)
            operands = [values] if start is None else [ir.Constant(ir.FloatType(), start), values]
            kind = ir.FunctionType(ir.FloatType(), [operand.type for operand in operands])
            function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.{name}.v{LANES}f32")
            return builder.call(function, operands, fastmath=("reassoc", "nsz", "nnan"))

        return types.float32(buffer, types.uint64), codegen

    return fold


lane_sum = _reduction("fadd", 0.0)
lane_max = _reduction("fmax", None)


@intrinsic
def take_ticket(typingctx: Any, counter: Any) -> Any:
    """Atomically return counter[0] and add one to it. counter int64[1]"""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("add", data, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counter), codegen
