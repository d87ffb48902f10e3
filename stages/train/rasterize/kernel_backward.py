"""Numba: gradients of every tile. Each tile is blended again into a list of rows, then walked back to front.

With c_i the derivative by the weight of splat i at a pixel and B_i what lies behind it, dL/dalpha_i = T_i (c_i - B_i) and
B_(i-1) = alpha_i c_i + (1 - alpha_i) B_i: no division by 1 - alpha. A (tile, splat) pair writes one slot of its own, so
the sums are in one fixed order whatever the threads do.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .kernel_bin import TILE_H, TILE_W
from .kernel_project import BOTTOM, CX, CY, G_GEO, OPACITY, QX, QY, TOP, UX, UY, VX, VY, Z
from .kernel_row import (
    ALPHA,
    ALPHA_MAX,
    BEFORE,
    CHANNELS,
    FAST,
    HALF,
    MOMENT1,
    MOMENT2,
    ONE,
    PIXELS,
    Q_MIN,
    TRANSMITTANCE,
    WEIGHT,
    ZERO,
    blend_row,
    row_range,
    start_tile,
)
from .lanes import LANES, lane_max, lane_sum, take_ticket

_f = np.float32
_u = np.uint64

# The buffer of `kernel_row`, with CHANNELS holding the cotangents of the attributes, then:
N_EXTRA = 5  # planes after the attributes: cotangents of alpha, expected, median depth, distortion; B (behind)
C_ROW = 0  # row of dL/dweight, in the sums' area


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def weight_derivative(buffer: np.ndarray, row: int, attribute: np.ndarray, out: int) -> None:
    """out row = sum over channels of attribute * cotangent."""
    o = _u(out)
    for i in range(LANES):
        buffer[o + _u(i)] = ZERO
    for c in range(len(attribute)):
        value = attribute[c]
        plane = _u(CHANNELS + c * PIXELS + row * LANES)
        for i in range(LANES):
            buffer[o + _u(i)] += buffer[plane + _u(i)] * value


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def attribute_sums(buffer: np.ndarray, row: int, channels: int, sums: int) -> None:
    """Add weight * cotangent to the running rows of the attributes."""
    for c in range(channels):
        plane = _u(CHANNELS + c * PIXELS + row * LANES)
        total = _u(sums + c * LANES)
        for i in range(LANES):
            buffer[total + _u(i)] += buffer[_u(WEIGHT + i)] * buffer[plane + _u(i)]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def row_backward(
    buffer: np.ndarray,
    g: np.ndarray,
    row: int,
    x0: float,
    y: float,
    z_ref: float,
    screen: float,
    extra: int,
    sums: int,
) -> None:
    """Chain one row: from dL/dweight (row at `sums` - LANES) to the G_GEO running rows at `sums`."""
    dy = y - g[CY]
    x0 -= g[CX]
    ux, vx, qx, uy, vy, qy, opacity, z0 = g[UX], g[VX], g[QX], g[UY], g[VY], g[QY], g[OPACITY], g[Z]
    u0, v0, q0 = uy * dy, vy * dy, ONE + qy * dy
    base = _u(row * LANES)
    e, s, derivative = _u(extra) + base, _u(sums), _u(sums - LANES)
    for i in range(LANES):
        dx = x0 + _f(i)
        q = q0 + qx * dx
        inverse = ONE / max(q, Q_MIN)
        u, v = (u0 + ux * dx) * inverse, (v0 + vx * dx) * inverse
        alpha, before = buffer[_u(ALPHA + i)], buffer[_u(BEFORE + i)]
        hit = alpha > ZERO
        weight = alpha * before
        after = before * (ONE - alpha)
        on_screen = screen * (dx * dx + dy * dy) < u * u + v * v
        z = z0 if on_screen else z0 * inverse
        far = z - z_ref
        g_depth, g_spread = buffer[e + _u(PIXELS + i)], buffer[e + _u(3 * PIXELS + i)]
        total = ONE - buffer[_u(TRANSMITTANCE) + base + _u(i)]
        m1, m2 = buffer[_u(MOMENT1) + base + _u(i)], buffer[_u(MOMENT2) + base + _u(i)]
        c = buffer[derivative + _u(i)] + buffer[e + _u(i)] + z * g_depth
        c += g_spread * (m2 + far * (total * far - m1 - m1))
        behind = buffer[e + _u(4 * PIXELS + i)]
        d_alpha = before * (c - behind)
        buffer[e + _u(4 * PIXELS + i)] = alpha * c + (ONE - alpha) * behind if hit else behind
        d_z = weight * (g_depth + (g_spread + g_spread) * (total * far - m1))
        halves = (before > HALF) & (after <= HALF)
        d_z = d_z + (buffer[e + _u(2 * PIXELS + i)] if halves else ZERO)
        d_z = d_z if hit else ZERO
        d_log = d_alpha * alpha if hit & (alpha < ALPHA_MAX) else ZERO  # by log of opacity * kernel
        d_rho = _f(-0.5) * d_log
        step = ZERO if on_screen else (d_rho + d_rho) * inverse
        d_u, d_v = u * step, v * step
        d_q = -(d_u * u + d_v * v) - (ZERO if on_screen else d_z * inverse * z)
        d_u = d_u if hit else ZERO
        d_v = d_v if hit else ZERO
        d_q = d_q if hit else ZERO
        pull = _f(-2) * screen * d_rho
        d_cx = dx * pull if on_screen else -(d_u * ux + d_v * vx + d_q * qx)
        d_cy = dy * pull if on_screen else -(d_u * uy + d_v * vy + d_q * qy)
        buffer[s + _u(i)] += d_u * dx
        buffer[s + _u(LANES + i)] += d_u * dy
        buffer[s + _u(2 * LANES + i)] += d_v * dx
        buffer[s + _u(3 * LANES + i)] += d_v * dy
        buffer[s + _u(4 * LANES + i)] += d_q * dx
        buffer[s + _u(5 * LANES + i)] += d_q * dy
        buffer[s + _u(6 * LANES + i)] += d_cx
        buffer[s + _u(7 * LANES + i)] += d_cy
        buffer[s + _u(8 * LANES + i)] += d_z if on_screen else d_z * inverse
        buffer[s + _u(9 * LANES + i)] += d_log / opacity
        buffer[s + _u(10 * LANES + i)] += abs(d_cx)
        buffer[s + _u(11 * LANES + i)] += abs(d_cy)


@njit(cache=True, nogil=True, error_model="numpy")
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
    columns = (width + TILE_W - 1) // TILE_W
    extra = CHANNELS + channels * PIXELS
    sums = extra + N_EXTRA * PIXELS + LANES
    buffer = np.zeros(sums + (G_GEO + channels) * LANES, np.float32)
    longest = 0
    for tile in range(len(tile_used)):
        longest = max(longest, tile_used[tile])
    rows = np.empty((longest * TILE_H, 2, LANES), np.float32)  # alpha, transmittance before
    row_of = np.empty(longest * TILE_H, np.int32)
    row_end = np.empty(longest, np.int64)
    while True:
        tile = take_ticket(counter)
        if tile >= len(tile_start) - 1:
            return
        first, used = tile_start[tile], tile_used[tile]
        if used == 0:
            continue
        left, top = (tile % columns) * TILE_W, (tile // columns) * TILE_H
        start_tile(buffer, mask, left, top, width, height, channels + N_EXTRA)
        for r in range(min(TILE_H, height - top)):
            for i in range(min(TILE_W, width - left)):
                if mask[top + r, left + i]:
                    for c in range(channels):
                        buffer[CHANNELS + c * PIXELS + r * LANES + i] = d_image[top + r, left + i, c]
                    for c in range(4):
                        buffer[extra + c * PIXELS + r * LANES + i] = d_scalars[c, top + r, left + i]
        z_ref = geo[pair_splat[first], Z]
        count = 0
        for p in range(used):
            g = geo[pair_splat[first + p]]
            r0, r1 = row_range(g[TOP], g[BOTTOM], top)
            for r in range(r0, r1):
                blend_row(buffer, g, r, _f(left) + HALF, _f(top + r) + HALF, z_ref, screen)
                if lane_max(buffer, _u(ALPHA)) > 0:
                    for i in range(LANES):
                        rows[count, 0, i] = buffer[ALPHA + i]
                        rows[count, 1, i] = buffer[BEFORE + i]
                    row_of[count] = r
                    count += 1
            row_end[p] = count
        for p in range(used - 1, -1, -1):
            s = pair_splat[first + p]
            slot = slots[pair_slot[first + p]]
            for j in range(sums, sums + (G_GEO + channels) * LANES):
                buffer[j] = ZERO
            for j in range(row_end[p - 1] if p else 0, row_end[p]):
                r = row_of[j]
                for i in range(LANES):
                    buffer[ALPHA + i] = rows[j, 0, i]
                    buffer[BEFORE + i] = rows[j, 1, i]
                    buffer[WEIGHT + i] = rows[j, 0, i] * rows[j, 1, i]
                weight_derivative(buffer, r, attributes[s], sums - LANES)
                row_backward(buffer, geo[s], r, _f(left) + HALF, _f(top + r) + HALF, z_ref, screen, extra, sums)
                attribute_sums(buffer, r, channels, sums + G_GEO * LANES)
            for c in range(G_GEO + channels):
                slot[c] = lane_sum(buffer, _u(sums + c * LANES))
