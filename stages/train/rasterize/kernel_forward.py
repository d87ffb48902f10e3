"""Numba: blend every tile front to back."""

from __future__ import annotations

import numpy as np

from .compiling import kernel
from .kernel_block import (
    BLOCK,
    BLOCKS,
    CHANNELS,
    HALF,
    MEDIAN,
    MOMENT1,
    MOMENT2,
    ONE,
    PIXELS,
    TILE,
    TRANSMITTANCE,
    ZERO,
    blend_block,
    block_range,
    pixel_place,
    start_tile,
)
from .kernel_project import Z
from .simd import LANES, any_lane, largest, load, maximum, spread, store, take_ticket

_f = np.float32


@kernel
def open_blocks(buffer: np.ndarray, is_open: np.ndarray) -> int:
    """Mark the blocks with unfinished pixels; returns how many there are. is_open [BLOCKS^2] bool"""
    count = 0
    for block in range(BLOCKS * BLOCKS):
        is_open[block] = any_lane(load(buffer, TRANSMITTANCE + block * LANES) > ZERO)
        count += is_open[block]
    return count


@kernel
def blend_tiles(
    counter: np.ndarray,
    tile_start: np.ndarray,
    pair_splat: np.ndarray,
    pair_slot: np.ndarray,
    geo: np.ndarray,
    attributes: np.ndarray,
    mask: np.ndarray,
    screen: float,
    image: np.ndarray,
    scalars: np.ndarray,
    pair_weight: np.ndarray,
    tile_used: np.ndarray,
) -> None:
    """Fill image [H, W, A], scalars [4, H, W] (alpha, expected and median depth, distortion), pair_weight [S] (largest
    weight, by slot) and tile_used [tiles] (pairs until every pixel was finished)."""
    height, width, channels = image.shape
    columns = (width + TILE - 1) // TILE
    buffer = np.empty(CHANNELS + channels * PIXELS, np.float32)
    is_open = np.empty(BLOCKS * BLOCKS, np.bool_)
    while True:
        tile = take_ticket(counter)
        if tile >= len(tile_start) - 1:
            return
        first, last = tile_start[tile], tile_start[tile + 1]
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        if first == last:
            continue
        start_tile(buffer, mask, left, top, channels)
        remaining = open_blocks(buffer, is_open)
        z_ref = geo[pair_splat[first], Z]
        used = last - first
        for p in range(first, last):
            s = pair_splat[p]
            g = geo[s]
            peak = spread(ZERO)
            b0, b1, c0, c1 = block_range(g, left, top)
            for line in range(c0, c1):
                for column in range(b0, b1):
                    block = line * BLOCKS + column
                    if not is_open[block]:
                        continue
                    x0, y0 = _f(left + column * BLOCK) + HALF, _f(top + line * BLOCK) + HALF
                    hit, still_open, alpha, before = blend_block(buffer, g, block, x0, y0, z_ref, screen)
                    if hit:
                        weight = alpha * before
                        peak = maximum(peak, weight)
                        for c in range(channels):
                            at = CHANNELS + c * PIXELS + block * LANES
                            store(buffer, at, load(buffer, at) + weight * attributes[s, c])
                        if not still_open:
                            is_open[block] = False
                            remaining -= 1
            pair_weight[pair_slot[p]] = largest(peak)
            if remaining == 0:
                used = p - first + 1
                break
        tile_used[tile] = used
        for line in range(min(TILE, height - top)):
            for column in range(min(TILE, width - left)):
                at = pixel_place(line, column)
                y, x = top + line, left + column
                for c in range(channels):
                    image[y, x, c] = buffer[CHANNELS + c * PIXELS + at]
                alpha_sum = ONE - abs(buffer[TRANSMITTANCE + at])
                m1, m2 = buffer[MOMENT1 + at], buffer[MOMENT2 + at]
                scalars[0, y, x] = alpha_sum
                scalars[1, y, x] = m1 + z_ref * alpha_sum
                scalars[2, y, x] = buffer[MEDIAN + at]
                scalars[3, y, x] = max(alpha_sum * m2 - m1 * m1, ZERO)
