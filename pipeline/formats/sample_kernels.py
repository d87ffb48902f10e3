"""Stored samples to float: one pass over a band of rows that fits the cache."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.kernels.compiling import kernel

_TO_SINGLE = np.float32(2.0**112)
"""A half's exponent bias is 15, a float's 127: shifted bits are low by 2^112, subnormal halves included."""
CHUNK = 2048
"""Samples whose three passes stay in the first-level cache."""
_HALF_SPECIAL = np.float32(65536.0)


@kernel(nogil=True)
def _widen_chunk(bits: NDArray[np.uint16], out: NDArray[np.float32], out_bits: NDArray[np.uint32]) -> None:
    n = bits.size
    for i in range(n):
        out_bits[i] = np.uint32(bits[i] & np.uint16(0x7FFF)) << np.uint32(13)
    for i in range(n):
        out[i] *= _TO_SINGLE
    for i in range(n):
        special = np.uint32(0x7F800000) if out[i] >= _HALF_SPECIAL else np.uint32(0)
        out_bits[i] |= special | (np.uint32(bits[i] & np.uint16(0x8000)) << np.uint32(16))


@kernel(nogil=True)
def widen_halves(bits: NDArray[np.uint16], out: NDArray[np.float32], out_bits: NDArray[np.uint32]) -> None:
    """Widen half floats to single ones, exactly, also NaN and infinity.

    Args:
        bits: the halves' bits. [N]
        out: filled. [N]
        out_bits: a view of `out`. [N]
    """
    for start in range(0, bits.size, CHUNK):
        stop = start + CHUNK
        _widen_chunk(bits[start:stop], out[start:stop], out_bits[start:stop])


@kernel(nogil=True)
def look_up(codes: NDArray, table: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Decode stored samples by a table.

    Args:
        codes: unsigned integers. [N]
        table: value of every possible code. [codes]
        out: filled. [N]
    """
    for i in range(codes.size):
        out[i] = table[codes[i]]


@kernel(nogil=True)
def mark_at_least(codes: NDArray, limit: int, alpha: int, out: NDArray[np.bool_]) -> None:
    """Mark the pixels of which any colour reaches a limit, as saturated ones do.

    Args:
        codes: unsigned integers. [P, C]
        limit: lowest code that counts.
        alpha: channel that is left out, -1: none.
        out: filled. [P]
    """
    pixels, channels = codes.shape
    for p in range(pixels):
        top = np.int64(0)
        for c in range(channels):
            if c != alpha:
                top = max(top, np.int64(codes[p, c]))
        out[p] = top >= limit
