"""Sixteen float32 lanes as a numba type, and what else numba lacks for these kernels.

numba leaves vector code to LLVM's auto-vectoriser, which gives up on the loops here (selects, short reductions, possible
overlap) without a word: a factor of ten. So the lanes are explicit: `Row` is LLVM's <16 x float> (one AVX-512 register, two
AVX2, four SSE or NEON ones), with + - * /, comparisons that give a `Mask`, and the functions below. Scalars broadcast.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.extending import lower_builtin, models, register_model, type_callable

intrinsic: Any = extending.intrinsic  # numba's annotation shows the compiler's arguments, not the caller's

LANES = 16
_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_ROW, _MASK = ir.VectorType(_FLOAT, LANES), ir.VectorType(ir.IntType(1), LANES)
_FLAGS = ("contract", "nsz", "arcp")
"""Fused multiply-add allowed; comparisons with NaN and infinity keep their meaning."""


class RowType(types.Type):
    """LANES float32."""

    def __init__(self) -> None:
        super().__init__("Row")


class MaskType(types.Type):
    """LANES booleans."""

    def __init__(self) -> None:
        super().__init__("Mask")


row, mask = RowType(), MaskType()


@register_model(RowType)
class _RowModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _ROW)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _MASK)


def _spread(context: Any, builder: Any, value: Any, kind: Any) -> Any:
    """The value as a Row; scalars go to every lane."""
    if kind == row:
        return value
    value = context.cast(builder, value, kind, types.float32)
    single = builder.insert_element(ir.Constant(_ROW, ir.Undefined), value, ir.Constant(_INT, 0))
    return builder.shuffle_vector(single, single, ir.Constant(ir.VectorType(_INT, LANES), [0] * LANES))


def _binary(symbols: tuple[Callable[..., Any], ...], result: Any, emit: Callable[[Any, Any, Any], Any]) -> None:
    """Register an operator (and its in-place form) on (Row, Row), (Row, number) and (number, Row)."""

    def typing(context: Any) -> Any:
        def typer(x: Any, y: Any) -> Any:
            return result if row in (x, y) and all(a == row or isinstance(a, types.Number) for a in (x, y)) else None

        return typer

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (_spread(context, builder, value, kind) for value, kind in zip(args, sig.args))
        return emit(builder, a, b)

    for symbol in symbols:
        type_callable(symbol)(typing)
        for kinds in ((row, row), (row, types.Number), (types.Number, row)):
            lower_builtin(symbol, *kinds)(lower)


_binary((operator.add, operator.iadd), row, lambda b, x, y: b.fadd(x, y, flags=_FLAGS))
_binary((operator.sub, operator.isub), row, lambda b, x, y: b.fsub(x, y, flags=_FLAGS))
_binary((operator.mul, operator.imul), row, lambda b, x, y: b.fmul(x, y, flags=_FLAGS))
_binary((operator.truediv,), row, lambda b, x, y: b.fdiv(x, y, flags=_FLAGS))
_binary((operator.lt,), mask, lambda b, x, y: b.fcmp_ordered("<", x, y))
_binary((operator.le,), mask, lambda b, x, y: b.fcmp_ordered("<=", x, y))
_binary((operator.gt,), mask, lambda b, x, y: b.fcmp_ordered(">", x, y))
_binary((operator.ge,), mask, lambda b, x, y: b.fcmp_ordered(">=", x, y))


def _logical(symbol: Callable[..., Any], emit: Callable[[Any, Any, Any], Any]) -> None:
    @type_callable(symbol)
    def typing(context: Any) -> Any:
        return lambda x, y: mask if x == y == mask else None

    lower_builtin(symbol, mask, mask)(lambda context, builder, sig, args: emit(builder, *args))


_logical(operator.and_, lambda b, x, y: b.and_(x, y))
_logical(operator.or_, lambda b, x, y: b.or_(x, y))


def _call(builder: Any, name: str, result: Any, arguments: list[Any], flags: tuple[str, ...] = ()) -> Any:
    """Call an LLVM intrinsic by name."""
    kind = ir.FunctionType(result, [a.type for a in arguments])
    function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
    return builder.call(function, arguments, fastmath=flags)


def _place(context: Any, builder: Any, kind: Any, buffer: Any, offset: Any) -> Any:
    """Pointer to LANES values of a float32 array, as a Row."""
    data = context.make_array(kind)(context, builder, buffer).data
    return builder.bitcast(builder.gep(data, [offset]), _ROW.as_pointer())


@intrinsic
def load(typingctx: Any, buffer: Any, offset: Any) -> Any:
    """Read buffer[offset : offset + LANES]; no bounds check.

    Args:
        typingctx: numba's; not given by the caller.
        buffer: float32, contiguous. [...]
        offset: of the first element.

    Returns:
        Row.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_place(context, builder, sig.args[0], *args), align=4)

    return row(buffer, types.intp), codegen


@intrinsic
def value(typingctx: Any, buffer: Any, offset: Any) -> Any:
    """Read buffer[offset] without numba's test for a negative index; no bounds check.

    Args:
        typingctx: numba's; not given by the caller.
        buffer: float32, contiguous, any shape. [...]
        offset: in elements.

    Returns:
        float32.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.load(builder.gep(data, [args[1]]))

    return types.float32(buffer, types.intp), codegen


@intrinsic
def prefetch(typingctx: Any, buffer: Any, offset: Any) -> Any:
    """Ask for the cache line of buffer[offset]; a hint, so any offset will do.

    Args:
        typingctx: numba's; not given by the caller.
        buffer: contiguous. [...]
        offset: of the element.

    Returns:
        None.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        flags = [ir.Constant(_INT, flag) for flag in (0, 3, 1)]  # for reading, into every level, data
        kind = ir.FunctionType(ir.VoidType(), [place.type, _INT, _INT, _INT])
        name = "llvm.prefetch.p0"
        builder.call(builder.module.globals.get(name) or ir.Function(builder.module, kind, name), [place, *flags])
        return context.get_dummy_value()

    return types.void(buffer, types.intp), codegen


@intrinsic
def store(typingctx: Any, buffer: Any, offset: Any, value: Any) -> Any:
    """Write buffer[offset : offset + LANES]; no bounds check.

    Args:
        typingctx: numba's; not given by the caller.
        buffer: float32, contiguous. [...]
        offset: of the first element.
        value: Row.

    Returns:
        None.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], _place(context, builder, sig.args[0], *args[:2]), align=4)
        return context.get_dummy_value()

    return types.void(buffer, types.intp, row), codegen


@intrinsic
def spread(typingctx: Any, value: Any) -> Any:
    """Put a number into every lane.

    Args:
        typingctx: numba's; not given by the caller.
        value: number.

    Returns:
        Row.
    """
    return row(value), lambda context, builder, sig, args: _spread(context, builder, args[0], sig.args[0])


@intrinsic
def select(typingctx: Any, condition: Any, yes: Any, no: Any) -> Any:
    """Per lane: `yes` where the condition holds, else `no`.

    Args:
        typingctx: numba's; not given by the caller.
        condition: Mask.
        yes, no: Row or number.

    Returns:
        Row.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (_spread(context, builder, value, kind) for value, kind in zip(args[1:], sig.args[1:]))
        return builder.select(args[0], a, b)

    return row(mask, yes, no), codegen


def _extremum(comparison: str, doc: str) -> Any:
    @intrinsic
    def extremum(typingctx: Any, x: Any, y: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            a, b = (_spread(context, builder, value, kind) for value, kind in zip(args, sig.args))
            return builder.select(builder.fcmp_ordered(comparison, a, b), a, b)

        return row(x, y), codegen

    extremum.__doc__ = doc
    return extremum


minimum = _extremum("<", "Per lane the smaller; the second where the first is NaN.")
maximum = _extremum(">", "Per lane the larger; the second where the first is NaN.")


@intrinsic
def absolute(typingctx: Any, x: Any) -> Any:
    """Per lane |x|.

    Args:
        typingctx: numba's; not given by the caller.
        x: Row.

    Returns:
        Row.
    """
    return row(row), lambda context, builder, sig, args: _call(builder, f"llvm.fabs.v{LANES}f32", _ROW, [args[0]])


@intrinsic
def store_totals(typingctx: Any, buffer: Any, offset: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Write the totals of four Rows to buffer[offset : offset + 4]; a third of the instructions of four `total`s.

    Args:
        typingctx: numba's; not given by the caller.
        buffer: float32, contiguous. [...]
        offset: of the first element.
        a, b, c, d: Rows.

    Returns:
        None.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def pick(x: Any, y: Any, lanes: list[int]) -> Any:
            return builder.shuffle_vector(x, y, ir.Constant(ir.VectorType(_INT, len(lanes)), lanes))

        def fold(x: Any, y: Any, width: int) -> Any:
            """Lanes of x then y, in groups of `width`, each group's two halves added: half as many lanes in all."""
            half = width // 2
            low = [i + j for i in range(0, 2 * LANES, width) for j in range(half)]
            return builder.fadd(pick(x, y, low), pick(x, y, [i + half for i in low]))

        def shrink(x: Any, width: int, lanes: int) -> Any:
            low = [i + j for i in range(0, lanes, width) for j in range(width // 2)]
            return builder.fadd(pick(x, x, low), pick(x, x, [i + width // 2 for i in low]))

        ab, cd = fold(args[2], args[3], LANES), fold(args[4], args[5], LANES)  # 2 groups of 8 lanes each
        result = shrink(shrink(fold(ab, cd, LANES // 2), 4, LANES), 2, LANES // 2)  # 4 groups of 4, of 2, of 1
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), result.type.as_pointer())
        builder.store(result, place, align=4)
        return context.get_dummy_value()

    return types.void(buffer, types.intp, row, row, row, row), codegen


@intrinsic
def largest(typingctx: Any, x: Any) -> Any:
    """Find the largest lane; none may be NaN.

    Args:
        typingctx: numba's; not given by the caller.
        x: Row.

    Returns:
        float32.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, f"llvm.vector.reduce.fmax.v{LANES}f32", _FLOAT, [args[0]], ("nnan", "nsz"))

    return types.float32(row), codegen


@intrinsic
def any_lane(typingctx: Any, condition: Any) -> Any:
    """Say whether a condition holds in any lane.

    Args:
        typingctx: numba's; not given by the caller.
        condition: Mask.

    Returns:
        bool.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, f"llvm.vector.reduce.or.v{LANES}i1", ir.IntType(1), [args[0]])

    return types.boolean(mask), codegen


def _constant(values: list[float], doc: str) -> Any:
    @intrinsic
    def constant(typingctx: Any) -> Any:
        return row(), lambda context, builder, sig, args: ir.Constant(_ROW, values)

    constant.__doc__ = doc
    return constant


BLOCK = 4
"""Lanes are a square of BLOCK x BLOCK pixels: round splats touch a third fewer such squares than rows of 16."""

TILE = 24
"""Pixels a side of the square that one thread blends at a time. By measurement (20k splats on 192 x 192 pixels, one thread):
forward 6.0 / 5.5 / 5.4 ms and backward 8.9 / 8.0 / 8.1 ms at 16 / 24 / 32; smaller ones share the work better among threads."""

lane_x = _constant([float(i % BLOCK) for i in range(LANES)], "Column of each lane in its block.")
lane_y = _constant([float(i // BLOCK) for i in range(LANES)], "Line of each lane in its block.")


@intrinsic
def take_ticket(typingctx: Any, counters: Any, which: Any) -> Any:
    """Atomically read counters[which] and add one to it; numba has no atomics on the CPU.

    Args:
        typingctx: numba's; not given by the caller.
        counters: int64. [n]
        which: of the counters.

    Returns:
        int64, before the one was added.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", builder.gep(data, [args[1]]), ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counters, types.intp), codegen
