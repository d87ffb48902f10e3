"""Numba: gradients of every tile. Each tile is blended again into a list of blocks, then walked back to front.

With c_i the derivative by the weight of splat i at a pixel and B_i what lies behind it, dL/dalpha_i = T_i (c_i - B_i) and
B_(i-1) = alpha_i c_i + (1 - alpha_i) B_i: no division by 1 - alpha. A (tile, splat) pair writes one slot of its own, so
the sums are in one fixed order whatever the threads do.
"""

from __future__ import annotations

import numpy as np

from .compiling import kernel
from .kernel_block import (
    ALPHA_MAX,
    BLOCK,
    BLOCKS,
    CHANNELS,
    HALF,
    MOMENT1,
    MOMENT2,
    ONE,
    PIXELS,
    TILE,
    TRANSMITTANCE,
    TWO,
    ZERO,
    blend_block,
    block_range,
    intersect,
    pixel_place,
    start_tile,
)
from .kernel_forward import open_blocks
from .kernel_project import G_GEO, OPACITY, QX, QY, UX, UY, VX, VY, Z
from .simd import LANES, absolute, load, maximum, select, spread, store, take_ticket, total

_f = np.float32

# planes after the attributes: cotangents of alpha, expected depth, median depth, distortion; what lies behind
ALPHA_PLANE, EXPECTED_PLANE, MEDIAN_PLANE, DISTORTION_PLANE, BEHIND = range(5)
EXTRA = 5


@kernel
def replay_tile(
    buffer: np.ndarray,
    is_open: np.ndarray,
    splats: np.ndarray,
    geo: np.ndarray,
    left: int,
    top: int,
    screen: float,
    blended: np.ndarray,
    block_of: np.ndarray,
    pair_end: np.ndarray,
) -> None:
    """Blend a tile again, listing each blended block's alpha and transmittance before (blended, 2 LANES an entry), its
    place (block_of) and, by pair, the end of its entries (pair_end)."""
    open_blocks(buffer, is_open)
    z_ref = geo[splats[0], Z]
    count = 0
    for p in range(len(splats)):
        g = geo[splats[p]]
        b0, b1, c0, c1 = block_range(g, left, top)
        for line in range(c0, c1):
            for column in range(b0, b1):
                block = line * BLOCKS + column
                if not is_open[block]:
                    continue
                x0, y0 = _f(left + column * BLOCK) + HALF, _f(top + line * BLOCK) + HALF
                hit, still_open, alpha, before = blend_block(buffer, g, block, x0, y0, z_ref, screen)
                if hit:
                    store(blended, 2 * LANES * count, alpha)
                    store(blended, 2 * LANES * count + LANES, before)
                    block_of[count] = block
                    count += 1
                    is_open[block] = still_open
        pair_end[p] = count


@kernel
def pair_backward(
    buffer: np.ndarray,
    g: np.ndarray,
    attribute: np.ndarray,
    blended: np.ndarray,
    block_of: np.ndarray,
    first: int,
    last: int,
    left: int,
    top: int,
    z_ref: float,
    screen: float,
    slot: np.ndarray,
) -> None:
    """Gradients of one splat in one tile, over its blended blocks first..last. slot [G_GEO + A]"""
    channels = len(attribute)
    extra = CHANNELS + channels * PIXELS
    sum_ux = sum_uy = sum_vx = sum_vy = sum_qx = sum_qy = spread(ZERO)
    sum_cx = sum_cy = sum_z = sum_log = sum_ax = sum_ay = spread(ZERO)
    for j in range(first, last):
        block = block_of[j]
        at = block * LANES
        alpha, before = load(blended, 2 * LANES * j), load(blended, 2 * LANES * j + LANES)
        x0 = _f(left + block % BLOCKS * BLOCK) + HALF
        y0 = _f(top + block // BLOCKS * BLOCK) + HALF
        dx, dy, u, v, inverse, _, on_screen = intersect(g, x0, y0, screen)
        hit = alpha > ZERO
        weight = alpha * before
        after = before * (ONE - alpha)
        z = select(on_screen, g[Z], g[Z] * inverse)

        far = z - z_ref
        g_depth = load(buffer, extra + EXPECTED_PLANE * PIXELS + at)
        g_spread = load(buffer, extra + DISTORTION_PLANE * PIXELS + at)
        final = load(buffer, TRANSMITTANCE + at)
        lean = (ONE - maximum(final, ZERO - final)) * far - load(buffer, MOMENT1 + at)
        by_weight = load(buffer, extra + ALPHA_PLANE * PIXELS + at) + z * g_depth
        by_weight += g_spread * (load(buffer, MOMENT2 + at) + far * (lean - load(buffer, MOMENT1 + at)))
        for c in range(channels):
            by_weight += load(buffer, CHANNELS + c * PIXELS + at) * attribute[c]

        behind = load(buffer, extra + BEHIND * PIXELS + at)
        d_alpha = before * (by_weight - behind)
        store(buffer, extra + BEHIND * PIXELS + at, alpha * by_weight + (ONE - alpha) * behind)
        halves = hit & (before > HALF) & (after <= HALF)
        d_z = weight * (g_depth + TWO * g_spread * lean)
        d_z += select(halves, load(buffer, extra + MEDIAN_PLANE * PIXELS + at), ZERO)

        d_log = select(hit & (alpha < ALPHA_MAX), d_alpha * alpha, ZERO)  # by log of opacity * kernel
        step = select(on_screen, ZERO, ZERO - d_log * inverse)
        d_u, d_v = select(hit, u * step, ZERO), select(hit, v * step, ZERO)
        d_z_object = select(on_screen, ZERO, d_z * inverse)
        d_q = select(hit, ZERO - d_u * u - d_v * v - d_z_object * z, ZERO)
        pull = select(on_screen, screen * d_log, ZERO)
        d_cx = dx * pull - d_u * g[UX] - d_v * g[VX] - d_q * g[QX]
        d_cy = dy * pull - d_u * g[UY] - d_v * g[VY] - d_q * g[QY]
        sum_ux += d_u * dx
        sum_uy += d_u * dy
        sum_vx += d_v * dx
        sum_vy += d_v * dy
        sum_qx += d_q * dx
        sum_qy += d_q * dy
        sum_cx += d_cx
        sum_cy += d_cy
        sum_z += select(on_screen, d_z, d_z_object)
        sum_log += d_log
        sum_ax += absolute(d_cx)
        sum_ay += absolute(d_cy)
    slot[0], slot[1], slot[2], slot[3] = total(sum_ux), total(sum_uy), total(sum_vx), total(sum_vy)
    slot[4], slot[5], slot[6], slot[7] = total(sum_qx), total(sum_qy), total(sum_cx), total(sum_cy)
    slot[8], slot[9] = total(sum_z), total(sum_log) / g[OPACITY]
    slot[10], slot[11] = total(sum_ax), total(sum_ay)
    for c in range(channels):
        sum_c = spread(ZERO)
        for j in range(first, last):
            weight = load(blended, 2 * LANES * j) * load(blended, 2 * LANES * j + LANES)
            sum_c += weight * load(buffer, CHANNELS + c * PIXELS + block_of[j] * LANES)
        slot[G_GEO + c] = total(sum_c)


@kernel
def tiles_backward(
    counter: np.ndarray,
    tile_start: np.ndarray,
    tile_used: np.ndarray,
    pair_splat: np.ndarray,
    pair_slot: np.ndarray,
    geo: np.ndarray,
    attributes: np.ndarray,
    mask: np.ndarray,
    screen: float,
    d_image: np.ndarray,
    d_scalars: np.ndarray,
    slots: np.ndarray,
) -> None:
    """Fill slots [S, G_GEO + A] from the cotangents d_image [H, W, A] and d_scalars [4, H, W]."""
    height, width, channels = d_image.shape
    columns = (width + TILE - 1) // TILE
    extra = CHANNELS + channels * PIXELS
    buffer = np.empty(extra + EXTRA * PIXELS, np.float32)
    is_open = np.empty(BLOCKS * BLOCKS, np.bool_)
    longest = 0
    for tile in range(len(tile_used)):
        longest = max(longest, tile_used[tile])
    blended = np.empty(longest * BLOCKS * BLOCKS * 2 * LANES, np.float32)
    block_of = np.empty(longest * BLOCKS * BLOCKS, np.uint8)
    pair_end = np.empty(longest, np.int64)
    while True:
        tile = take_ticket(counter)
        if tile >= len(tile_start) - 1:
            return
        first, used = tile_start[tile], tile_used[tile]
        if used == 0:
            continue
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        start_tile(buffer, mask, left, top, channels + EXTRA)
        for line in range(min(TILE, height - top)):
            for column in range(min(TILE, width - left)):
                y, x = top + line, left + column
                if mask[y, x]:
                    at = pixel_place(line, column)
                    for c in range(channels):
                        buffer[CHANNELS + c * PIXELS + at] = d_image[y, x, c]
                    for c in range(4):
                        buffer[extra + c * PIXELS + at] = d_scalars[c, y, x]
        splats = pair_splat[first : first + used]
        replay_tile(buffer, is_open, splats, geo, left, top, screen, blended, block_of, pair_end)
        z_ref = geo[splats[0], Z]
        for p in range(used - 1, -1, -1):
            begin = pair_end[p - 1] if p else 0
            if begin < pair_end[p]:
                s = splats[p]
                pair_backward(
                    buffer, geo[s], attributes[s], blended, block_of, begin, pair_end[p], left, top, z_ref, screen,
                    slots[pair_slot[first + p]],
                )  # fmt: skip
