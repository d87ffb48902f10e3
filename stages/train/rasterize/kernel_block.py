"""Numba: one splat over one block of BLOCK x BLOCK pixels, and the planes of a tile it works in."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.simd import (
    BLOCK,
    LANES,
    TILE,
    absolute,
    any_lane,
    lane_x,
    lane_y,
    load,
    maximum,
    minimum,
    prefetch,
    select,
    spread,
    store,
)

from . import constants as k
from .kernel_project import BOTTOM, CX, CY, FLAT, GEO, LEFT, OPACITY, Q_MAX, QX, QY, RIGHT, STATE, TOP, UX, UY, VX, VY, Z

BLOCKS = TILE // BLOCK  # a side
LAYERS = k.MAX_LAYERS - 1  # that can end: what comes after is one

# A tile works in one flat float32 buffer: block after block of `stride` values, each a list of rows of LANES:
TRANSMITTANCE = 0  # negative: the pixel is finished (or not wanted), the size is its final transmittance
END = LANES  # place in the tile's list of the splat that finished the pixel; infinity: none; -1: not wanted
MEDIAN = 2 * LANES
MOMENT1 = 3 * LANES  # sum of w (z - z_ref)
MOMENT2 = 4 * LANES  # sum of w (z - z_ref)^2
LAYER_Z = 5 * LANES  # layered only: intersection that began the layer at hand, its transmittance before, its sum of alpha
LAYER_BEFORE = 6 * LANES
LAYER_SUM = 7 * LANES
BOUND = 8 * LANES  # LAYERS rows: place in the tile's list that ended a layer; infinity: it has not ended
CHANNELS = (8 + LAYERS) * LANES  # blended attributes (forward) or their cotangents (backward), a row each

COVERED, SHARE, LEFT_OVER = (LANES * i for i in range(3))  # of a layer's record, before its attributes
RECORD_ROWS = 3

AHEAD = 3
"""Splats of a tile's list to fetch ahead of the one at hand."""

GROUP = 4
"""Attributes are padded to a multiple of this and handled so many at a time, to keep that many sums going at once."""

_f = np.float32
ONE, ZERO, HALF, TWO = _f(1), _f(0), _f(0.5), _f(2)
CUTOFF_RHO = _f(k.CUTOFF_RHO)
BEYOND = _f(2 * k.CUTOFF_RHO)
LEAST = _f(k.LEAST_TRANSMITTANCE)
ENDLESS = _f(1e30)  # above every place in a list, below infinity
ALPHA_MIN, ALPHA_MAX, STOP = _f(k.ALPHA_MIN), _f(k.ALPHA_MAX), _f(k.TRANSMITTANCE_STOP)
Q_MIN = _f(k.MIN_RELATIVE_DEPTH_INVERSE)

# exp(t) on [-9/16, 0], degree 5 at the Chebyshev nodes, relative error 3e-8; squared three times it reaches -4.5
_fit = np.polynomial.Chebyshev.interpolate(np.exp, 5, domain=[-k.CUTOFF_RHO / 16, 0.0])
E0, E1, E2, E3, E4, E5 = (_f(c) for c in _fit.convert(kind=np.polynomial.Polynomial).coef)
TO_T = _f(-1 / 16)


@kernel(nogil=True, error_model="numpy", allocates=False)
def intersect(g: np.ndarray, x0: float, y0: float, screen: float) -> tuple:
    """Splat record g on the block whose first pixel centre is (x0, y0).

    Returns rows dx, dy, u, v, 1/q, rho (BEYOND where missed), and the mask of lanes where the screen-space kernel rules.
    screen: SCREEN_INVERSE_VARIANCE; infinity without the low-pass filter (0 * infinity loses both comparisons).
    """
    dx = lane_x() + (x0 - g[CX])
    dy = lane_y() + (y0 - g[CY])
    q = ONE + g[QX] * dx + g[QY] * dy
    inverse = ONE / maximum(q, Q_MIN)
    u = (g[UX] * dx + g[UY] * dy) * inverse
    v = (g[VX] * dx + g[VY] * dy) * inverse
    q_max = ZERO if g[STATE] == FLAT else g[Q_MAX]
    rho_object = select((q > Q_MIN) & (q <= q_max), u * u + v * v, BEYOND)
    rho_screen = screen * (dx * dx + dy * dy)
    return dx, dy, u, v, inverse, minimum(rho_screen, rho_object), rho_screen < rho_object


@kernel(nogil=True, error_model="numpy", allocates=False)
def kernel_value(rho: np.ndarray) -> np.ndarray:
    """exp(-rho / 2) for rho in [0, CUTOFF_RHO]. Row -> Row"""
    t = rho * TO_T
    power = E0 + t * (E1 + t * (E2 + t * (E3 + t * (E4 + t * E5))))
    power = power * power
    power = power * power
    return power * power


@kernel(nogil=True, error_model="numpy", allocates=False)
def capped_alpha(opacity: float, rho: np.ndarray) -> np.ndarray:
    """Opacity at rho, up to ALPHA_MAX. Row -> Row"""
    return minimum(opacity * kernel_value(rho), ALPHA_MAX)


@kernel(nogil=True, error_model="numpy", allocates=False)
def blend_block(
    buffer: np.ndarray,
    at: int,
    g: np.ndarray,
    place: int,
    x0: float,
    y0: float,
    z_ref: float,
    screen: float,
    layer: float,
    record: np.ndarray,
    channels: int,
) -> tuple:
    """Blend the splat at `place` of the tile's list into the block at buffer[at]; updates its rows but CHANNELS.

    Returns whether anything was blended, whether the block has open pixels left, the row to multiply the splat's attributes
    with (its weights; with layers its alphas, see `end_layers`), and the row of largest possible weights.
    """
    _, _, _, _, inverse, rho, on_screen = intersect(g, x0, y0, screen)
    inside = rho <= CUTOFF_RHO
    if not any_lane(inside):
        return False, True, rho, rho
    before = load(buffer, at + TRANSMITTANCE)
    alpha = capped_alpha(g[OPACITY], rho)
    hit = inside & (alpha >= ALPHA_MIN) & (before > ZERO)
    if not any_lane(hit):
        return False, True, rho, rho
    z = select(on_screen, g[Z], g[Z] * inverse)
    alpha = select(hit, alpha, ZERO)
    after = before * (ONE - alpha)
    if layer > ZERO:
        farther = hit & (load(buffer, at + LAYER_SUM) > ZERO) & (z > load(buffer, at + LAYER_Z) + layer)
        stop = (farther & (before < STOP)) | (hit & (after < LEAST))
        if any_lane(farther):
            end_layers(buffer, at, place, farther & (before >= STOP), record, channels)
    else:
        stop = hit & (after < STOP)
    if any_lane(stop):
        alpha = select(stop, ZERO, alpha)
        after = select(stop, ZERO - before, after)
        store(buffer, at + END, select(stop, spread(place), load(buffer, at + END)))
    weight = select(hit, alpha * before, ZERO)
    far = (z - z_ref) * weight
    store(buffer, at + TRANSMITTANCE, after)
    store(buffer, at + MEDIAN, select((before > HALF) & (absolute(after) <= HALF), z, load(buffer, at + MEDIAN)))
    store(buffer, at + MOMENT1, load(buffer, at + MOMENT1) + far)
    store(buffer, at + MOMENT2, load(buffer, at + MOMENT2) + far * (z - z_ref))
    still_open = any_lane(after > ZERO)
    if layer > ZERO:
        total = load(buffer, at + LAYER_SUM)
        store(buffer, at + LAYER_Z, select((alpha > ZERO) & (total <= ZERO), z, load(buffer, at + LAYER_Z)))
        store(buffer, at + LAYER_SUM, total + alpha)
        return True, still_open, alpha, alpha * load(buffer, at + LAYER_BEFORE)
    return True, still_open, weight, weight


@kernel(nogil=True, error_model="numpy", allocates=False)
def end_layers(buffer: np.ndarray, at: int, place: int, ends: np.ndarray, record: np.ndarray, channels: int) -> None:
    """End the layer at hand in the lanes `ends`, where that many can end, and begin one with the splat at `place`.

    A layer covers c = T_first - T_last of the light and shows its splats' mean attributes, weighted by alpha: none hides
    another that lies in the same surface. record, by layer, of [RECORD_ROWS + channels] rows: c, c / sum of alpha, T_last,
    and the sums of c * attribute.
    """
    left = load(buffer, at + TRANSMITTANCE)
    before, total = load(buffer, at + LAYER_BEFORE), load(buffer, at + LAYER_SUM)
    covered = before - left
    share = covered / select(total > ZERO, total, ONE)
    ended = ends & (load(buffer, at + BOUND + (LAYERS - 1) * LANES) > ENDLESS)
    if not any_lane(ended):
        return
    pending = ended
    for i in range(LAYERS):
        bound = load(buffer, at + BOUND + i * LANES)
        here = pending & (bound > ENDLESS)
        if any_lane(here):
            store(buffer, at + BOUND + i * LANES, select(here, spread(place), bound))
            base = i * (RECORD_ROWS + channels) * LANES
            keep_lanes(record, base + COVERED, here, covered)
            keep_lanes(record, base + SHARE, here, share)
            keep_lanes(record, base + LEFT_OVER, here, left)
            for c in range(channels):
                blended = load(buffer, at + CHANNELS + c * LANES) * share
                keep_lanes(record, base + (RECORD_ROWS + c) * LANES, here, blended)
        pending = pending & (bound <= ENDLESS)
    for c in range(channels):
        row = at + CHANNELS + c * LANES
        store(buffer, row, select(ended, ZERO, load(buffer, row)))
    store(buffer, at + LAYER_BEFORE, select(ended, left, before))
    store(buffer, at + LAYER_SUM, select(ended, ZERO, total))


@kernel(nogil=True, error_model="numpy", allocates=False)
def keep_lanes(record: np.ndarray, row: int, lanes: np.ndarray, values: np.ndarray) -> None:
    """Store the values in these lanes of a record's row."""
    store(record, row, select(lanes, values, load(record, row)))


@kernel(nogil=True, error_model="numpy", allocates=False)
def finish_layers(buffer: np.ndarray, stride: int, record: np.ndarray, channels: int) -> None:
    """Turn every block's attribute rows, sums of alpha * attribute in the last layer, into what all layers show."""
    size = LAYERS * (RECORD_ROWS + channels) * LANES
    for block in range(BLOCKS * BLOCKS):
        at = block * stride
        total = load(buffer, at + LAYER_SUM)
        covered = load(buffer, at + LAYER_BEFORE) - absolute(load(buffer, at + TRANSMITTANCE))
        share = select(total > ZERO, covered / select(total > ZERO, total, ONE), ZERO)
        for c in range(channels):
            row = at + CHANNELS + c * LANES
            store(buffer, row, load(buffer, row) * share)
        for i in range(LAYERS):
            ended = load(buffer, at + BOUND + i * LANES) <= ENDLESS
            if not any_lane(ended):
                break
            base = block * size + i * (RECORD_ROWS + channels) * LANES + RECORD_ROWS * LANES
            for c in range(channels):
                row = at + CHANNELS + c * LANES
                store(buffer, row, load(buffer, row) + select(ended, load(record, base + c * LANES), ZERO))


@kernel(nogil=True, error_model="numpy", allocates=False)
def start_tile(buffer: np.ndarray, stride: int, mask: np.ndarray, left: int, top: int) -> None:
    """Reset a tile's blocks; pixels outside the image or the mask start finished. mask [H, W] bool"""
    height, width = mask.shape
    for i in range(BLOCKS * BLOCKS * stride):
        buffer[i] = ZERO
    for block in range(BLOCKS * BLOCKS):
        store(buffer, block * stride + TRANSMITTANCE, spread(-ONE))
        store(buffer, block * stride + END, spread(-ONE))
        store(buffer, block * stride + LAYER_BEFORE, spread(ONE))
        for i in range(LAYERS):
            store(buffer, block * stride + BOUND + i * LANES, spread(np.inf))
    for line in range(min(TILE, height - top)):
        for column in range(min(TILE, width - left)):
            if mask[top + line, left + column]:
                at = pixel_place(line, column, stride)
                buffer[at + TRANSMITTANCE] = ONE
                buffer[at + END] = np.inf


@kernel(nogil=True, error_model="numpy", allocates=False)
def pixel_place(line: int, column: int, stride: int) -> int:
    """Index of a tile's pixel in the first row of its block."""
    return ((line // BLOCK) * BLOCKS + column // BLOCK) * stride + (line % BLOCK) * BLOCK + column % BLOCK


@kernel(nogil=True, error_model="numpy", allocates=False)
def block_interval(low: float, high: float, origin: int) -> tuple:
    """First and last + 1 block of the tile at `origin` that has pixel centres in [low, high] (px)."""
    first = max(low - _f(origin) - HALF, ZERO)
    last = min(high - _f(origin) - HALF, _f(TILE - 1))
    if not last >= first:
        return 0, 0
    pixel = int(first)
    pixel += int(pixel < first)  # rounded up; both are >= 0
    return pixel // BLOCK, int(last) // BLOCK + 1


@kernel(nogil=True, error_model="numpy", allocates=False)
def prefetch_splat(geo: np.ndarray, attributes: np.ndarray, s: int) -> None:
    """Fetch a splat's records ahead: they lie anywhere, and waiting for them took a quarter of the time."""
    prefetch(geo, s * GEO)
    width = attributes.shape[1]
    for c in range(0, width, LANES):
        prefetch(attributes, s * width + c)
    prefetch(attributes, s * width + width - 1)


@kernel(nogil=True, error_model="numpy", allocates=False)
def block_range(g: np.ndarray, left: int, top: int) -> tuple:
    """Columns and lines of blocks under the splat's bounding box: first, last + 1, first, last + 1."""
    b0, b1 = block_interval(g[LEFT], g[RIGHT], left)
    c0, c1 = block_interval(g[TOP], g[BOTTOM], top)
    return b0, b1, c0, c1
