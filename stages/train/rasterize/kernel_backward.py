"""Numba: gradients of every tile, back to front.

With c_i the derivative by the weight of splat i at a pixel and B_i what lies behind it, dL/dalpha_i = T_i (c_i - B_i) and
B_(i-1) = alpha_i c_i + (1 - alpha_i) B_i. T_i is found again from the last one, T_i = T_(i+1) / (1 - alpha_i): alpha is at
most ALPHA_MAX, and rounding adds up to 1e-7 a splat. A (tile, splat) pair writes one slot of its own, so the sums are in
one fixed order whatever the threads do.
"""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.simd import (
    BLOCK,
    LANES,
    TILE,
    absolute,
    any_lane,
    largest,
    load,
    select,
    spread,
    store,
    store_totals,
    take_ticket,
    value,
)

from .kernel_block import (
    AHEAD,
    ALPHA_MAX,
    ALPHA_MIN,
    BLOCKS,
    BOUND,
    CHANNELS,
    COVERED,
    CUTOFF_RHO,
    END,
    ENDLESS,
    GROUP,
    HALF,
    LAYER_BEFORE,
    LAYER_SUM,
    LAYERS,
    LEFT_OVER,
    MEDIAN,
    MOMENT1,
    MOMENT2,
    ONE,
    RECORD_ROWS,
    SHARE,
    TRANSMITTANCE,
    TWO,
    ZERO,
    block_range,
    capped_alpha,
    intersect,
    pixel_place,
    prefetch_splat,
)
from .kernel_project import G_GEO, OPACITY, QX, QY, UX, UY, VX, VY, Z

_f = np.float32

# Rows of a block after the cotangents of its attributes: cotangents of alpha, expected depth, median depth and distortion,
# and what lies behind. Of the forward pass's rows, MEDIAN holds the pixel's final alpha here.
BY_ALPHA, BY_EXPECTED, BY_MEDIAN, BY_DISTORTION, BEHIND = (LANES * i for i in range(5))
# With layers, for each that ended and then for the last: c / sum of alpha, the mean of c_i, and the derivative by log of what
# the layer lets through (`lay_out_layers`).
OF_LAYER = 5 * LANES
LAYER_ROWS = 3 * LANES
LAST = OF_LAYER + LAYERS * LAYER_ROWS
EXTRA = LAST + LAYER_ROWS
FINAL_ALPHA = MEDIAN


def backward_room(attributes: int) -> int:
    """Floats of workspace `tiles_backward` needs per thread."""
    return BLOCKS * BLOCKS * (CHANNELS + attributes * LANES + EXTRA + LANES + 2)


def slot_width(attributes: int) -> int:
    """Floats of a gradient slot: G_GEO and the attributes, filled up to whole rows."""
    return -(-(G_GEO + attributes) // LANES) * LANES


@kernel(nogil=True, error_model="numpy", allocates=False)
def pair_backward(
    buffer: np.ndarray,
    stride: int,
    weights: np.ndarray,
    places: np.ndarray,
    block_end: np.ndarray,
    g: np.ndarray,
    attribute: np.ndarray,
    channels: int,
    place: int,
    left: int,
    top: int,
    z_ref: float,
    screen: float,
    layered: bool,
    with_distortion: bool,
    slots: np.ndarray,
    slot: int,
) -> None:
    """Gradients of the splat at `place` of a tile's list, to slots[slot : slot + G_GEO + A], from the first `channels`
    attributes.

    weights [BLOCKS^2 LANES], places [BLOCKS^2]: room for the splat's weights and the blocks they belong to.
    """
    count = 0
    here = _f(place)
    sum_ux = sum_uy = sum_vx = sum_vy = sum_qx = sum_qy = spread(ZERO)
    sum_cx = sum_cy = sum_z = sum_log = sum_ax = sum_ay = spread(ZERO)
    b0, b1, c0, c1 = block_range(g, left, top)
    for line in range(c0, c1):
        for column in range(b0, b1):
            block = line * BLOCKS + column
            if here >= value(block_end, block):
                continue
            x0, y0 = _f(left + column * BLOCK) + HALF, _f(top + line * BLOCK) + HALF
            dx, dy, u, v, inverse, rho, on_screen = intersect(g, x0, y0, screen)
            inside = rho <= CUTOFF_RHO
            if not any_lane(inside):
                continue
            at = block * stride
            alpha = capped_alpha(g[OPACITY], rho)
            hit = inside & (alpha >= ALPHA_MIN) & (load(buffer, at + END) > here)
            if not any_lane(hit):
                continue
            alpha = select(hit, alpha, ZERO)
            after = load(buffer, at + TRANSMITTANCE)
            before = after / (ONE - alpha)
            weight = alpha * before
            store(buffer, at + TRANSMITTANCE, before)
            z = select(on_screen, g[Z], g[Z] * inverse)
            extra = at + stride - EXTRA
            d_z_by_weight = load(buffer, extra + BY_EXPECTED)
            by_weight = load(buffer, extra + BY_ALPHA) + z * d_z_by_weight
            c_0 = c_1 = c_2 = c_3 = spread(ZERO)
            for c in range(0, channels, GROUP):
                row = at + CHANNELS + c * LANES
                c_0 += load(buffer, row) * value(attribute, c)
                c_1 += load(buffer, row + LANES) * value(attribute, c + 1)
                c_2 += load(buffer, row + 2 * LANES) * value(attribute, c + 2)
                c_3 += load(buffer, row + 3 * LANES) * value(attribute, c + 3)
            if with_distortion:
                far = z - z_ref
                m1 = load(buffer, at + MOMENT1)
                lean = load(buffer, at + FINAL_ALPHA) * far - m1
                by_distortion = load(buffer, extra + BY_DISTORTION)
                d_z_by_weight += TWO * by_distortion * lean
                by_weight += by_distortion * (load(buffer, at + MOMENT2) + far * (lean - m1))
            by_feature = (c_0 + c_1) + (c_2 + c_3)
            amount = weight
            d_layer = spread(ZERO)
            if layered:
                share, mean, gone = layer_rows(buffer, at, extra, here)
                amount = alpha * share
                d_layer = select(hit, share * (by_feature - mean) + gone / (ONE - alpha), ZERO)
            else:
                by_weight += by_feature
            store(weights, count * LANES, amount)
            places[count] = at + CHANNELS
            count += 1
            behind = load(buffer, extra + BEHIND)
            d_alpha = before * (by_weight - behind) + d_layer
            store(buffer, extra + BEHIND, behind + alpha * (by_weight - behind))
            halves = hit & (before > HALF) & (after <= HALF)
            d_z = weight * d_z_by_weight + select(halves, load(buffer, extra + BY_MEDIAN), ZERO)

            d_log = select(hit & (alpha < ALPHA_MAX), d_alpha * alpha, ZERO)  # by log of opacity * kernel
            on_plane = select(on_screen, ZERO, inverse)
            d_u = select(hit, ZERO - u * d_log * on_plane, ZERO)
            d_v = select(hit, ZERO - v * d_log * on_plane, ZERO)
            d_z_plane = d_z * on_plane
            d_q = select(hit, ZERO - d_u * u - d_v * v - d_z_plane * z, ZERO)
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
            sum_z += select(on_screen, d_z, d_z_plane)
            sum_log += d_log
            sum_ax += absolute(d_cx)
            sum_ay += absolute(d_cy)
    store_totals(slots, slot, sum_ux, sum_uy, sum_vx, sum_vy)
    store_totals(slots, slot + 4, sum_qx, sum_qy, sum_cx, sum_cy)
    store_totals(slots, slot + 8, sum_z, sum_log / g[OPACITY], sum_ax, sum_ay)
    for c in range(0, channels, GROUP):
        s_0 = s_1 = s_2 = s_3 = spread(ZERO)
        for j in range(count):
            weight = load(weights, j * LANES)
            row = int(value(places, j)) + c * LANES
            s_0 += weight * load(buffer, row)
            s_1 += weight * load(buffer, row + LANES)
            s_2 += weight * load(buffer, row + 2 * LANES)
            s_3 += weight * load(buffer, row + 3 * LANES)
        store_totals(slots, slot + G_GEO + c, s_0, s_1, s_2, s_3)
    for c in range(channels, len(attribute), GROUP):
        store_totals(slots, slot + G_GEO + c, spread(ZERO), spread(ZERO), spread(ZERO), spread(ZERO))


@kernel(nogil=True, error_model="numpy", allocates=False)
def layer_rows(buffer: np.ndarray, at: int, extra: int, here: float) -> tuple:
    """The three rows of the layer that the splat at place `here` belongs to, lane by lane."""
    share = load(buffer, extra + LAST)
    mean = load(buffer, extra + LAST + LANES)
    gone = load(buffer, extra + LAST + 2 * LANES)
    if any_lane(load(buffer, at + BOUND) <= ENDLESS):
        for i in range(LAYERS - 1, -1, -1):
            mine = load(buffer, at + BOUND + i * LANES)
            inside = (mine > here) & (mine <= ENDLESS)
            row = extra + OF_LAYER + i * LAYER_ROWS
            share = select(inside, load(buffer, row), share)
            mean = select(inside, load(buffer, row + LANES), mean)
            gone = select(inside, load(buffer, row + 2 * LANES), gone)
    return share, mean, gone


@kernel(nogil=True, error_model="numpy", allocates=False)
def lay_out_layers(buffer: np.ndarray, stride: int, record: np.ndarray, channels: int, attributes: int) -> None:
    """Fill every block's rows of layers. Row BEHIND holds the image's product with its cotangent, and is 0 afterwards.

    A layer with coverage c that lets T_last through, of whose splats the mean of c_i is m, adds c m. So dL/dalpha_i =
    (c / sum of alpha) (c_i - m) + (T_last m - what all later layers add) / (1 - alpha_i).
    """
    size = LAYERS * (RECORD_ROWS + attributes) * LANES
    for block in range(BLOCKS * BLOCKS):
        at = block * stride
        extra = at + stride - EXTRA
        later = load(buffer, extra + BEHIND)
        store(buffer, extra + BEHIND, spread(ZERO))
        for i in range(LAYERS):
            ended = load(buffer, at + BOUND + i * LANES) <= ENDLESS
            if not any_lane(ended):
                break
            base = block * size + i * (RECORD_ROWS + attributes) * LANES
            adds = spread(ZERO)
            for c in range(channels):
                adds += load(buffer, at + CHANNELS + c * LANES) * load(record, base + (RECORD_ROWS + c) * LANES)
            later = later - select(ended, adds, ZERO)
            covered = load(record, base + COVERED)
            mean = adds / select(covered > ZERO, covered, ONE)
            row = extra + OF_LAYER + i * LAYER_ROWS
            store(buffer, row, load(record, base + SHARE))
            store(buffer, row + LANES, mean)
            store(buffer, row + 2 * LANES, load(record, base + LEFT_OVER) * mean - later)
        left, total = load(buffer, at + TRANSMITTANCE), load(buffer, at + LAYER_SUM)
        covered = load(buffer, at + LAYER_BEFORE) - left
        mean = select(covered > ZERO, later / select(covered > ZERO, covered, ONE), ZERO)
        store(buffer, extra + LAST, covered / select(total > ZERO, total, ONE))
        store(buffer, extra + LAST + LANES, mean)
        store(buffer, extra + LAST + 2 * LANES, left * mean)


@kernel(nogil=True, error_model="numpy", allocates=False)
def read_tile(
    buffer: np.ndarray,
    stride: int,
    block_end: np.ndarray,
    state: np.ndarray,
    left: int,
    top: int,
    features: np.ndarray,
    normal: np.ndarray,
    d_features: np.ndarray,
    d_normal: np.ndarray,
    d_scalars: np.ndarray,
    layered: bool,
) -> None:
    """Lay out a tile's final state and cotangents, and the place in its list where each block is finished (block_end).

    With layers, row BEHIND holds the product of the images with their cotangents.
    """
    height, width, channels = d_features.shape
    extra = stride - EXTRA
    for block in range(BLOCKS * BLOCKS):
        at = block * stride
        for i in range(CHANNELS):
            buffer[at + i] = state[block, i]
        for i in range(CHANNELS, stride):
            buffer[at + i] = ZERO
        final = absolute(load(buffer, at + TRANSMITTANCE))
        store(buffer, at + TRANSMITTANCE, final)
        store(buffer, at + FINAL_ALPHA, ONE - final)
        block_end[block] = largest(load(buffer, at + END))
    for line in range(min(TILE, height - top)):
        for column in range(min(TILE, width - left)):
            y, x = top + line, left + column
            at = pixel_place(line, column, stride)
            for c in range(channels):
                buffer[at + CHANNELS + c * LANES] = d_features[y, x, c]
            for c in range(3):
                buffer[at + CHANNELS + (channels + c) * LANES] = d_normal[y, x, c]
            for c in range(4):
                buffer[at + extra + c * LANES] = d_scalars[c, y, x]
            if layered:
                product = ZERO
                for c in range(channels):
                    product += d_features[y, x, c] * features[y, x, c]
                for c in range(3):
                    product += d_normal[y, x, c] * normal[y, x, c]
                buffer[at + extra + BEHIND] = product


@kernel(nogil=True, error_model="numpy", allocates=False)
def tiles_backward(
    counters: np.ndarray,
    tile_start: np.ndarray,
    tile_used: np.ndarray,
    tile_state: np.ndarray,
    records: np.ndarray,
    pair_splat: np.ndarray,
    pair_slot: np.ndarray,
    geo: np.ndarray,
    attributes: np.ndarray,
    screen: float,
    layer: float,
    with_distortion: bool,
    channels: int,
    features: np.ndarray,
    normal: np.ndarray,
    d_features: np.ndarray,
    d_normal: np.ndarray,
    d_scalars: np.ndarray,
    slots: np.ndarray,
    workspace: np.ndarray,
) -> None:
    """Fill slots [S, slot_width(A)] from the cotangents d_features [H, W, C], d_normal [H, W, 3], d_scalars [4, H, W].

    channels: attributes that have a cotangent, filled up to whole GROUPs; the rest get zeros.
    """
    columns = (d_features.shape[1] + TILE - 1) // TILE
    stride = CHANNELS + attributes.shape[1] * LANES + EXTRA
    buffer = workspace[take_ticket(counters, 1)]
    weights = buffer[BLOCKS * BLOCKS * stride :]
    block_end = weights[BLOCKS * BLOCKS * LANES :]
    places = block_end[BLOCKS * BLOCKS :]
    while True:
        tile = take_ticket(counters, 0)
        if tile >= len(tile_start) - 1:
            return
        first, used = tile_start[tile], tile_used[tile]
        for p in range(first + used, tile_start[tile + 1]):
            for c in range(0, slots.shape[1], LANES):
                store(slots, pair_slot[p] * slots.shape[1] + c, spread(ZERO))
        if used == 0:
            continue
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        layered = layer > ZERO
        state = tile_state[tile]
        read_tile(
            buffer, stride, block_end, state, left, top, features, normal, d_features, d_normal, d_scalars, layered
        )  # fmt: skip
        if layered:
            lay_out_layers(buffer, stride, records[tile], channels, attributes.shape[1])
        z_ref = geo[pair_splat[first], Z]
        for place in range(used - 1, -1, -1):
            s = pair_splat[first + place]
            prefetch_splat(geo, attributes, pair_splat[first + max(place - AHEAD, 0)])
            slot = pair_slot[first + place] * slots.shape[1]
            pair_backward(
                buffer, stride, weights, places, block_end, geo[s], attributes[s], channels, place, left, top, z_ref, screen,
                layered, with_distortion, slots, slot,
            )  # fmt: skip
