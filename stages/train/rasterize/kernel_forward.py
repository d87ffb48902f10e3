"""Numba: blend every tile front to back."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.simd import BLOCK, LANES, TILE, any_lane, largest, load, maximum, spread, store, take_ticket, value

from .kernel_block import (
    AHEAD,
    BLOCKS,
    CHANNELS,
    HALF,
    MEDIAN,
    MOMENT1,
    MOMENT2,
    ONE,
    TRANSMITTANCE,
    ZERO,
    blend_block,
    block_range,
    finish_layers,
    pixel_place,
    prefetch_splat,
    start_tile,
)
from .kernel_project import Z

_f = np.float32


def forward_room(attributes: int) -> int:
    """Floats of workspace `blend_tiles` needs per thread."""
    return BLOCKS * BLOCKS * (CHANNELS + attributes * LANES + 1)


@kernel(nogil=True, error_model="numpy", allocates=False)
def open_blocks(buffer: np.ndarray, stride: int, is_open: np.ndarray) -> int:
    """Mark the blocks with unfinished pixels; returns how many there are. is_open [BLOCKS^2] 1 or 0"""
    count = 0
    for block in range(BLOCKS * BLOCKS):
        still_open = any_lane(load(buffer, block * stride + TRANSMITTANCE) > ZERO)
        is_open[block] = ONE if still_open else ZERO
        count += still_open
    return count


@kernel(nogil=True, error_model="numpy", allocates=False)
def write_tile(
    buffer: np.ndarray,
    stride: int,
    left: int,
    top: int,
    z_ref: float,
    features: np.ndarray,
    normal: np.ndarray,
    scalars: np.ndarray,
) -> None:
    """Copy a finished tile to the images."""
    height, width, channels = features.shape
    for line in range(min(TILE, height - top)):
        for column in range(min(TILE, width - left)):
            at = pixel_place(line, column, stride)
            y, x = top + line, left + column
            for c in range(channels):
                features[y, x, c] = buffer[at + CHANNELS + c * LANES]
            for c in range(3):
                normal[y, x, c] = buffer[at + CHANNELS + (channels + c) * LANES]
            alpha = ONE - abs(buffer[at + TRANSMITTANCE])
            m1, m2 = buffer[at + MOMENT1], buffer[at + MOMENT2]
            scalars[0, y, x] = alpha
            scalars[1, y, x] = m1 + z_ref * alpha
            scalars[2, y, x] = buffer[at + MEDIAN]
            scalars[3, y, x] = max(alpha * m2 - m1 * m1, ZERO)


@kernel(nogil=True, error_model="numpy", allocates=False)
def blend_tiles(
    counters: np.ndarray,
    tile_start: np.ndarray,
    pair_splat: np.ndarray,
    pair_slot: np.ndarray,
    geo: np.ndarray,
    attributes: np.ndarray,
    mask: np.ndarray,
    screen: float,
    layer: float,
    features: np.ndarray,
    normal: np.ndarray,
    scalars: np.ndarray,
    pair_weight: np.ndarray,
    tile_used: np.ndarray,
    tile_state: np.ndarray,
    records: np.ndarray,
    workspace: np.ndarray,
) -> None:
    """Fill the images features [H, W, C], normal [H, W, 3], scalars [4, H, W] (alpha, expected and median depth,
    distortion), pair_weight [S] (largest weight, by slot), tile_used [tiles] (pairs until every pixel was finished) and, for
    `kernel_backward`, tile_state [tiles, BLOCKS^2, CHANNELS] (the blocks' rows at the end) and records [tiles, ...] (of the
    layers that ended, see `end_layers`). layer: depth of one, 0 for none."""
    width = features.shape[1]
    columns = (width + TILE - 1) // TILE
    channels = attributes.shape[1]
    stride = CHANNELS + channels * LANES
    buffer = workspace[take_ticket(counters, 1)]
    is_open = buffer[BLOCKS * BLOCKS * stride :]
    while True:
        tile = take_ticket(counters, 0)
        if tile >= len(tile_start) - 1:
            return
        first, last = tile_start[tile], tile_start[tile + 1]
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        start_tile(buffer, stride, mask, left, top)
        record_size = records.shape[1] // (BLOCKS * BLOCKS)
        remaining = open_blocks(buffer, stride, is_open)
        z_ref = geo[pair_splat[first], Z] if first < last else ZERO
        used = last - first
        for p in range(first, last):
            s = pair_splat[p]
            g = geo[s]
            prefetch_splat(geo, attributes, pair_splat[min(p + AHEAD, last - 1)])
            peak = spread(ZERO)
            b0, b1, c0, c1 = block_range(g, left, top)
            for line in range(c0, c1):
                for column in range(b0, b1):
                    block = line * BLOCKS + column
                    if is_open[block] == ZERO:
                        continue
                    at = block * stride
                    x0, y0 = _f(left + column * BLOCK) + HALF, _f(top + line * BLOCK) + HALF
                    record = records[tile, block * record_size :]
                    hit, still_open, amount, weight = blend_block(
                        buffer, at, g, p - first, x0, y0, z_ref, screen, layer, record, channels
                    )
                    if hit:
                        peak = maximum(peak, weight)
                        for c in range(channels):
                            to = at + CHANNELS + c * LANES
                            store(buffer, to, load(buffer, to) + amount * value(attributes, s * channels + c))
                        if not still_open:
                            is_open[block] = ZERO
                            remaining -= 1
            pair_weight[pair_slot[p]] = largest(peak)
            if remaining == 0:
                used = p - first + 1
                break
        for p in range(first + used, last):
            pair_weight[pair_slot[p]] = ZERO
        tile_used[tile] = used
        for block in range(BLOCKS * BLOCKS):
            for i in range(CHANNELS):
                tile_state[tile, block, i] = buffer[block * stride + i]
        if layer > ZERO:
            finish_layers(buffer, stride, records[tile], channels)
        write_tile(buffer, stride, left, top, z_ref, features, normal, scalars)


@kernel(nogil=True, error_model="numpy", allocates=False)
def largest_weights(slot_start: np.ndarray, pair_weight: np.ndarray, visible: np.ndarray) -> None:
    """visible [N] = the largest of each splat's pair weights, 0 without any."""
    for s in range(len(visible)):
        visible[s] = ZERO
        for slot in range(slot_start[s], slot_start[s + 1]):
            visible[s] = max(visible[s], pair_weight[slot])
