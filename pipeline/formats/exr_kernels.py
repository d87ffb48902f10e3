"""From an inflated EXR chunk to interleaved floats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.sample_kernels import widen_halves
from pipeline.kernels.compiling import kernel


@kernel(nogil=True)
def undo_predictor(inflated: NDArray[np.uint8], out: NDArray[np.uint16]) -> None:
    """Undo the predictor and byte shuffle of an inflated EXR chunk (zip codec, OpenEXR file layout).

    Each byte is stored as its difference to the one before plus 128, and the file's even bytes come before its odd ones.
    The running sum over the odd half starts at that of the whole even half, so both run at once.

    Args:
        inflated: the chunk's bytes. [2 N]
        out: filled with the samples' bytes, as words. [N]
    """
    n = out.size
    low, high = np.uint64(128), np.uint64(0)  # the first byte is stored as it is: its 128 is added back
    for i in range(n):
        high += np.uint64(inflated[i])
    high += np.uint64(128) + np.uint64(128) * np.uint64(n)  # a subtracted 128 is an added one, modulo 256
    for i in range(n):
        low += np.uint64(inflated[i]) + np.uint64(128)
        high += np.uint64(inflated[n + i]) + np.uint64(128)
        out[i] = np.uint16((low & np.uint64(255)) | ((high & np.uint64(255)) << np.uint64(8)))


@kernel(nogil=True)
def place_halves(
    words: NDArray[np.uint16],
    wide: NDArray[np.float32],
    wide_bits: NDArray[np.uint32],
    place: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Half floats words [rows, C W] to out [rows, W, C'], channel c at place[c]; `wide` [C W] is the workspace of a row."""
    for y in range(out.shape[0]):
        widen_halves(words[y], wide, wide_bits)
        _interleave(wide, place, out[y])


@kernel(nogil=True)
def place_floats(samples: NDArray[np.float32], place: NDArray[np.int64], out: NDArray[np.float32]) -> None:
    """Floats samples [rows, C W] to out [rows, W, C'], channel c at place[c]."""
    for y in range(out.shape[0]):
        _interleave(samples[y], place, out[y])


@kernel(nogil=True)
def _interleave(row: NDArray[np.float32], place: NDArray[np.int64], out: NDArray[np.float32]) -> None:
    width, channels = out.shape
    flat = out.reshape(-1)
    for c in range(place.size):
        samples, at = row[c * width : (c + 1) * width], place[c]
        for x in range(width):
            flat[x * channels + at] = samples[x]
