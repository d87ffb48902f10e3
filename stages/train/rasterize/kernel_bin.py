"""Numba: depth order, and for every tile of the image the splats whose bounding box touches it, front to back."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

from .kernel_project import CULLED, STATE, Z

DIGIT = 11  # bits a radix pass sorts by: three passes cover 32 bits, and the histogram stays in the L1 cache


@kernel(nogil=True, error_model="numpy")
def depth_order(geo: np.ndarray) -> np.ndarray:
    """Indices of the splats not culled, nearest centre first; equal depths keep their input order. [M] int32"""
    count = 0
    for s in range(len(geo)):
        count += geo[s, STATE] != CULLED
    index, other = np.empty(count, np.int32), np.empty(count, np.int32)
    depth = np.empty(count, np.float32)
    count = 0
    for s in range(len(geo)):
        if geo[s, STATE] != CULLED:
            index[count], depth[count] = s, geo[s, Z]
            count += 1
    key = depth.view(np.uint32)  # positive floats sort as their bits
    key_other = np.empty(count, np.uint32)
    histogram = np.empty(1 << DIGIT, np.int64)
    for step in range(3):
        shift = np.uint32(step * DIGIT)
        mask = np.uint32((1 << DIGIT) - 1)
        histogram[:] = 0
        for i in range(count):
            histogram[(key[i] >> shift) & mask] += 1
        total = 0
        for digit in range(1 << DIGIT):
            total, histogram[digit] = total + histogram[digit], total
        for i in range(count):
            digit = (key[i] >> shift) & mask
            place = histogram[digit]
            histogram[digit] = place + 1
            key_other[place], other[place] = key[i], index[i]
        key, key_other = key_other, key
        index, other = other, index
    return index


@kernel(nogil=True, error_model="numpy")
def bin_splats(box: np.ndarray, order: np.ndarray, wanted: np.ndarray) -> tuple:
    """Pairs (tile, splat) in tile order, front to back.

    box: tiles under each splat, empty where culled. [N, 4]; wanted: tiles to fill. [rows, columns] bool
    Returns tile_start [tiles + 1], pair_splat [S], pair_slot [S] (where the pair's gradients go: grouped by splat),
    slot_start [N + 1].
    """
    rows, columns = wanted.shape
    count = len(box)
    tile_start = np.zeros(rows * columns + 1, np.int64)
    slot_start = np.zeros(count + 1, np.int64)
    for s in range(count):
        for y in range(box[s, 2], box[s, 3]):
            for x in range(box[s, 0], box[s, 1]):
                if wanted[y, x]:
                    tile_start[y * columns + x + 1] += 1
                    slot_start[s + 1] += 1
    for t in range(rows * columns):
        tile_start[t + 1] += tile_start[t]
    for s in range(count):
        slot_start[s + 1] += slot_start[s]
    total = tile_start[-1]
    pair_splat, pair_slot = np.empty(total, np.int32), np.empty(total, np.int32)
    filled = tile_start[:-1].copy()
    for i in range(len(order)):
        s = order[i]
        slot = slot_start[s]
        for y in range(box[s, 2], box[s, 3]):
            for x in range(box[s, 0], box[s, 1]):
                if wanted[y, x]:
                    place = filled[y * columns + x]
                    filled[y * columns + x] = place + 1
                    pair_splat[place], pair_slot[place] = s, slot
                    slot += 1
    return tile_start, pair_splat, pair_slot, slot_start
