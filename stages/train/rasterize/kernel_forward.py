"""Numba: blend every tile front to back."""

from __future__ import annotations

import numpy as np
from numba import njit

from .kernel_bin import TILE_H, TILE_W
from .kernel_project import BOTTOM, TOP, Z
from .kernel_row import (
    CHANNELS,
    FAST,
    HALF,
    LIVE,
    MEDIAN,
    MOMENT1,
    MOMENT2,
    ONE,
    PIXELS,
    TRANSMITTANCE,
    WEIGHT,
    ZERO,
    any_live,
    blend_row,
    row_range,
    start_tile,
)
from .lanes import LANES, lane_max, take_ticket

CHECK_EVERY = 16  # splats between looks at whether the tile is finished

_f = np.float32
_u = np.uint64


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_channels(buffer: np.ndarray, row: int, attribute: np.ndarray) -> None:
    """Add weight * attribute to one row of every channel plane."""
    for c in range(len(attribute)):
        value = attribute[c]
        plane = _u(CHANNELS + c * PIXELS + row * LANES)
        for i in range(LANES):
            buffer[plane + _u(i)] += buffer[_u(WEIGHT + i)] * value


@njit(cache=True, nogil=True, error_model="numpy")
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
    columns = (width + TILE_W - 1) // TILE_W
    buffer = np.empty(CHANNELS + channels * PIXELS, np.float32)
    while True:
        tile = take_ticket(counter)
        if tile >= len(tile_start) - 1:
            return
        first, last = tile_start[tile], tile_start[tile + 1]
        left, top = (tile % columns) * TILE_W, (tile // columns) * TILE_H
        if first == last:
            continue
        start_tile(buffer, mask, left, top, width, height, channels)
        z_ref = geo[pair_splat[first], Z]
        used = last - first
        for p in range(first, last):
            if (p - first) % CHECK_EVERY == 0 and not any_live(buffer):
                used = p - first
                break
            s = pair_splat[p]
            g = geo[s]
            largest = ZERO
            r0, r1 = row_range(g[TOP], g[BOTTOM], top)
            for r in range(r0, r1):
                blend_row(buffer, g, r, _f(left) + HALF, _f(top + r) + HALF, z_ref, screen)
                weight = lane_max(buffer, _u(WEIGHT))
                if weight > 0:
                    largest = max(largest, weight)
                    add_channels(buffer, r, attributes[s])
            pair_weight[pair_slot[p]] = largest
        tile_used[tile] = used
        for r in range(min(TILE_H, height - top)):
            for i in range(min(TILE_W, width - left)):
                at = r * LANES + i
                y, x = top + r, left + i
                for c in range(channels):
                    image[y, x, c] = buffer[CHANNELS + c * PIXELS + at]
                alpha = ONE - buffer[TRANSMITTANCE + at]
                m1, m2 = buffer[MOMENT1 + at], buffer[MOMENT2 + at]
                scalars[0, y, x] = alpha
                scalars[1, y, x] = m1 + z_ref * alpha
                scalars[2, y, x] = buffer[MEDIAN + at]
                scalars[3, y, x] = max(alpha * m2 - m1 * m1, ZERO)
