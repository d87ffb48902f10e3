"""The kernel that picks a mask's pixels out of inflated EXR chunks. Importing this loads numba."""

from __future__ import annotations

import numpy as np
from numba import carray, types

from pipeline.formats.exr_kernels import undo_predictor
from pipeline.kernels.native import machine_code


def unpack(rows, width, channels, parts, chunk, first, red, green, blue, size, data, stored, starts, columns, words, out):
    """Fill `out` uint16 [P, 3, parts] from rows [0, size) of a frame, wanted from `first` on; all arrays by their addresses.

    data uint8: inflated chunks of `chunk` rows, each with its channels' samples row by row, a sample being `parts` words of 16
    bits; stored uint8: 1 for a chunk that was not compressed; starts int64 [rows + 1], columns int32 [P]: the pixels of each of
    the `rows` wanted; red, green, blue: which channels; words uint16: room for a chunk.
    """
    length = width * parts  # words of a channel in a row
    line = length * channels
    begins = carray(starts, rows + 1)
    at, places = carray(columns, begins[rows]), carray(out, begins[rows] * 3 * parts)
    chosen = (red * length, green * length, blue * length)
    for k in range((size + chunk - 1) // chunk):
        top = k * chunk
        bottom = min(top + chunk, size)
        count = (bottom - top) * line
        packed = carray(data, (k + 1) * chunk * line * 2)[top * line * 2 :]
        row = carray(words, chunk * line)
        if carray(stored, k + 1)[k]:
            for i in range(count):
                row[i] = packed[2 * i] | (np.uint16(packed[2 * i + 1]) << np.uint16(8))
        else:
            undo_predictor(packed, row[:count])
        for y in range(max(top, first), min(bottom, first + rows)):
            here = row[(y - top) * line :]
            for p in range(begins[y - first], begins[y - first + 1]):
                for c in range(3):
                    for q in range(parts):
                        places[(3 * p + c) * parts + q] = here[chosen[c] + at[p] * parts + q]


def build() -> tuple[str, bytes]:
    """Machine code of `unpack`."""
    byte, word = types.CPointer(types.uint8), types.CPointer(types.uint16)
    pointers = (byte, byte, types.CPointer(types.int64), types.CPointer(types.int32), word, word)
    return machine_code(unpack, (*[types.int64] * 10, *pointers))
