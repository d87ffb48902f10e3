"""Small numba building blocks of the per-pixel fits: an exponential that vectorises, order statistics, tiny solvers.

Loops over lights run in the arrays' own precision (float32 by default, float64 on request); sums that end in a solve
are handed to float64 scalars. Constants in the loops are float32 so that they do not widen a float32 loop.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types
from numba.extending import overload

from pipeline.kernels.compiling import kernel

FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
"""Reassociated sums (SIMD) and reciprocals, but NaN and Inf keep their meaning."""

ZERO, ONE, TWO, HALF, FOUR = (np.float32(v) for v in (0.0, 1.0, 2.0, 0.5, 4.0))
LARGEST = np.float32(1e30)  # of a sample: the squares of larger ones would overflow
TINY = np.float32(1e-30)  # keeps 0/0 at 0 where both are exact zeros; far below any sample, above float32's denormals

_LOG2E = np.float32(1.4426950408889634)
_EXP_FLOOR = np.float32(-87.0)  # exp(-87) is the last normal float32; a lobe there is 0 to any sample
_C = [np.float32(c) for c in np.polynomial.chebyshev.Chebyshev.interpolate(np.exp2, 6, domain=[0, 1])
      .convert(kind=np.polynomial.Polynomial).coef]  # fmt: skip
_C0, _C1, _C2, _C3, _C4, _C5, _C6 = _C
_BIAS, _SHIFT = np.int32(127), np.int32(23)


def exp(x):
    """Compute exp(x) for x <= 0; device function.

    Args:
        x: float32 or float64.

    Returns:
        In float32, vectorised, within 1.5e-7 + 6e-8 |x| relative (the product with log2 e rounds: 4e-6 where the value is
        1e-28, at the end of what float32 holds); in float64 the library's.
    """
    return math.exp(x)


@overload(exp, inline="always")
def _exp(x):
    if x == types.float32:

        def exp32(x):
            t = max(x, _EXP_FLOOR) * _LOG2E
            whole = np.floor(t)
            f = t - whole
            p = _C0 + f * (_C1 + f * (_C2 + f * (_C3 + f * (_C4 + f * (_C5 + f * _C6)))))
            bits = (np.int32(whole) + _BIAS) << _SHIFT  # the float32 whose value is 2**whole
            return p * np.int32(bits).view(np.float32)

        return exp32
    return lambda x: math.exp(x)


@kernel(error_model="numpy")
def copy1(source, target):
    """Copy a vector without the error message that numba would compile for `target[:] = source` (seconds of compile time).

    Args:
        source: as long as `target` at least. [N]
        target: filled. [N]
    """
    for k in range(target.size):
        target[k] = source[k]


@kernel(error_model="numpy")
def copy2(source, target):
    """Copy a matrix; see `copy1`.

    Args:
        source: as large as `target` at least. [N, M]
        target: filled. [N, M]
    """
    for j in range(target.shape[0]):
        for k in range(target.shape[1]):
            target[j, k] = source[j, k]


@kernel(fastmath=FAST, error_model="numpy")
def _count_from(values, level):
    n = ZERO  # as a float: numba widens the sum of integers to 64 bits, half as many at a time
    for k in range(values.size):
        n += ONE if values[k] >= level else ZERO
    return int(n)


@kernel(error_model="numpy")
def kth_largest(values, k):
    """Find an order statistic, to 2.5e-4 of itself; device function.

    Bisection of the bits of a positive float32, whose order is the floats': passes that count vectorise, a quickselect's
    branches are guessed wrong every other time.

    Args:
        values: float32. [N]
        k: 0 is the largest.

    Returns:
        The k-th largest; 0 where it is not above 0.
    """
    low, high = np.int32(0), np.int32(0x7F7FFFFF)  # 0 and the largest float32
    while high - low > np.int32(1 << 11):
        middle = np.int32(low + ((high - low) >> np.int32(1)))
        if _count_from(values, middle.view(np.float32)) > k:
            low = middle
        else:
            high = middle
    return np.int32(low).view(np.float32)


@kernel(error_model="numpy")
def solve3(a, b, c, d, e, f, x, y, z):
    """Solve [[a b c] [b d e] [c e f]] s = (x, y, z) in float64 by the adjugate; device function.

    Args:
        a, b, c, d, e, f: upper triangle of the symmetric, positive matrix, row by row.
        x, y, z: right-hand side.

    Returns:
        The three unknowns, and whether the matrix is well away from singular (else they are 0).
    """
    c00, c01, c02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * c00 + b * c01 + c * c02
    size = (a + d + f) / 3.0
    if not det > 1e-7 * size * size * size:  # lights within about 0.05 rad of one plane
        return 0.0, 0.0, 0.0, False
    c11, c12, c22 = a * f - c * c, b * c - a * e, a * d - b * b
    r = 1.0 / det
    return (c00 * x + c01 * y + c02 * z) * r, (c01 * x + c11 * y + c12 * z) * r, (c02 * x + c12 * y + c22 * z) * r, True


@kernel(error_model="numpy")
def cholesky_solve(matrix, rhs, n, out):
    """Solve a positive definite system by Cholesky's factorisation; device function.

    Args:
        matrix: lower triangle; overwritten by its factor. [n, n]
        rhs: right-hand side. [n]
        n: unknowns.
        out: filled with the solution. [n]

    Returns:
        False where the matrix is not positive definite; `out` then holds nothing of use.
    """
    for j in range(n):
        s = matrix[j, j]
        for k in range(j):
            s -= matrix[j, k] * matrix[j, k]
        if not s > 0.0:
            return False
        root = math.sqrt(s)
        matrix[j, j] = root
        for i in range(j + 1, n):
            t = matrix[i, j]
            for k in range(j):
                t -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = t / root
    for i in range(n):
        t = rhs[i]
        for k in range(i):
            t -= matrix[i, k] * out[k]
        out[i] = t / matrix[i, i]
    for i in range(n - 1, -1, -1):
        t = out[i]
        for k in range(i + 1, n):
            t -= matrix[k, i] * out[k]
        out[i] = t / matrix[i, i]
    return True
