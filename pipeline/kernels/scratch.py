"""Arrays for kernels that run without numba's runtime: small ones on the stack, and rows of a workspace."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array


def _vector(typing_context: Any, count: Any) -> Any:
    return _on_the_stack((count,))


def _matrix(typing_context: Any, rows: Any, columns: Any) -> Any:
    return _on_the_stack((rows, columns))


def _folded(typing_context: Any, flat: Any, rows: Any, columns: Any) -> Any:
    if not isinstance(flat, types.Array) or flat.layout != "C":
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source = make_array(flat)(context, builder, value=arguments[0])
        array = make_array(signature.return_type)(context, builder)
        size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(flat.dtype)))
        shape = [context.cast(builder, v, t, types.intp) for v, t in zip(arguments[1:], (rows, columns))]
        strides = [builder.mul(shape[1], size), size]
        populate_array(array, data=source.data, shape=shape, strides=strides, itemsize=size, meminfo=None)
        return array._getvalue()

    return types.Array(flat.dtype, 2, "C")(flat, rows, columns), generate


def _on_the_stack(extent: tuple[Any, ...]) -> tuple[Any, Callable] | None:
    if not all(isinstance(length, types.IntegerLiteral) for length in extent):
        return None
    shape = [length.literal_value for length in extent]

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = make_array(signature.return_type)(context, builder)
        number, size = context.get_data_type(types.float64), context.get_constant(types.intp, 8)
        count = 1
        for length in shape:
            count *= length
        strides = [8]
        for length in shape[:0:-1]:
            strides.insert(0, strides[0] * length)
        data = cgutils.alloca_once(builder, number, size=context.get_constant(types.intp, count))  # in the entry block
        lengths, steps = ([context.get_constant(types.intp, v) for v in values] for values in (shape, strides))
        populate_array(array, data=data, shape=lengths, strides=steps, itemsize=size, meminfo=None)
        return array._getvalue()

    return types.Array(types.float64, len(extent), "C")(*extent), generate


vector: Any = intrinsic(prefer_literal=True)(_vector)
"""vector(count): an array [count] of unset values, `count` a constant; it lives as long as the function that makes it runs."""
matrix: Any = intrinsic(prefer_literal=True)(_matrix)
"""matrix(rows, columns): the same, [rows, columns]."""
folded: Any = intrinsic(_folded)
"""folded(flat, rows, columns): the first numbers of the contiguous array `flat` as a matrix; none of it is checked."""
