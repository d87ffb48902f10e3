"""Numba: one splat over one row of a tile. The inner loops have LANES turns and no branches, so LLVM makes them vector code."""

from __future__ import annotations

import numpy as np
from numba import njit

from . import constants as k
from .kernel_bin import TILE_H
from .kernel_project import CUTOFF_RHO, CX, CY, FLAT, INVERSE_VARIANCE, OPACITY, Q_MAX, QX, QY, STATE, UX, UY, VX, VY, Z
from .lanes import LANES

PIXELS = LANES * TILE_H

# A tile works in one flat float32 buffer with fixed offsets, so that LLVM sees which rows cannot overlap.
ALPHA, WEIGHT, DEPTH = 0, LANES, 2 * LANES  # of the splat at hand, one row
BEFORE = 3 * LANES  # transmittance in front of it, one row
TRANSMITTANCE = 4 * LANES  # of the tile's pixels, from here on PIXELS each
LIVE = TRANSMITTANCE + PIXELS  # 1 until the pixel is finished or was never wanted
MEDIAN = LIVE + PIXELS
MOMENT1 = MEDIAN + PIXELS  # sum of w (z - z_ref)
MOMENT2 = MOMENT1 + PIXELS  # sum of w (z - z_ref)^2
CHANNELS = MOMENT2 + PIXELS  # blended attributes, PIXELS each

FAST = {"contract", "nsz", "arcp", "reassoc"}
"""fastmath without nnan and ninf: tests against NaN and infinity must keep their meaning."""

_f = np.float32
_u = np.uint64
ONE, ZERO, HALF = _f(1), _f(0), _f(0.5)
ALPHA_MIN, ALPHA_MAX, STOP = _f(k.ALPHA_MIN), _f(k.ALPHA_MAX), _f(k.TRANSMITTANCE_STOP)
Q_MIN = _f(k.MIN_RELATIVE_DEPTH_INVERSE)

# exp(x) on [-9/16, 0], Chebyshev fit of degree 5, relative error 3e-8: cubed squares carry it to [-4.5, 0]
_fit = np.polynomial.Chebyshev.interpolate(np.exp, 5, domain=[-CUTOFF_RHO / 16, 0.0])
E0, E1, E2, E3, E4, E5 = (_f(c) for c in _fit.convert(kind=np.polynomial.Polynomial).coef)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def blend_row(buffer: np.ndarray, g: np.ndarray, row: int, x0: float, y: float, z_ref: float, screen: float) -> None:
    """Blend splat record g into one row: writes ALPHA, WEIGHT, DEPTH, BEFORE; updates the tile's planes but CHANNELS.

    x0, y: centre of the row's first pixel; screen: INVERSE_VARIANCE, or infinity without the low-pass filter.
    """
    dy = y - g[CY]
    x0 -= g[CX]
    ux, vx, qx, opacity, z0, q_max = g[UX], g[VX], g[QX], g[OPACITY], g[Z], g[Q_MAX]
    u0, v0, q0 = g[UY] * dy, g[VY] * dy, ONE + g[QY] * dy
    if g[STATE] == FLAT:
        q_max = ZERO
    base = _u(row * LANES)
    for i in range(LANES):
        dx = x0 + _f(i)
        q = q0 + qx * dx
        u, v = u0 + ux * dx, v0 + vx * dx
        inverse = ONE / max(q, Q_MIN)
        solid = (u * u + v * v) * inverse * inverse
        flat = screen * (dx * dx + dy * dy)
        behind = (q <= Q_MIN) | (q > q_max)
        solid = CUTOFF_RHO + ONE if behind else solid
        rho = min(solid, flat)
        z = z0 if flat < solid else z0 * inverse
        t = rho * _f(-1 / 16)
        power = E0 + t * (E1 + t * (E2 + t * (E3 + t * (E4 + t * E5))))
        power *= power
        power *= power
        power *= power
        alpha = min(opacity * power, ALPHA_MAX)
        alpha = alpha * buffer[_u(LIVE) + base + _u(i)]
        alpha = alpha if (rho <= CUTOFF_RHO) & (alpha >= ALPHA_MIN) else ZERO
        before = buffer[_u(TRANSMITTANCE) + base + _u(i)]
        after = before * (ONE - alpha)
        stop = after < STOP
        alpha = ZERO if stop else alpha
        after = before if stop else after
        weight = alpha * before
        far = z - z_ref
        median = buffer[_u(MEDIAN) + base + _u(i)]
        buffer[_u(MEDIAN) + base + _u(i)] = z if (before > HALF) & (after <= HALF) else median
        buffer[_u(LIVE) + base + _u(i)] = ZERO if stop else buffer[_u(LIVE) + base + _u(i)]
        buffer[_u(TRANSMITTANCE) + base + _u(i)] = after
        buffer[_u(MOMENT1) + base + _u(i)] += weight * far
        buffer[_u(MOMENT2) + base + _u(i)] += weight * far * far
        buffer[_u(ALPHA + i)] = alpha
        buffer[_u(WEIGHT + i)] = weight
        buffer[_u(DEPTH + i)] = z
        buffer[_u(BEFORE + i)] = before


@njit(cache=True, nogil=True, error_model="numpy")
def start_tile(
    buffer: np.ndarray, mask: np.ndarray, left: int, top: int, width: int, height: int, channels: int
) -> None:
    """Reset a tile's planes; pixels outside the image or the mask start finished. mask [H, W] bool"""
    for i in range(TRANSMITTANCE, CHANNELS + channels * PIXELS):
        buffer[i] = ZERO
    for r in range(min(TILE_H, height - top)):
        for i in range(min(LANES, width - left)):
            buffer[LIVE + r * LANES + i] = ONE if mask[top + r, left + i] else ZERO
    for i in range(PIXELS):
        buffer[TRANSMITTANCE + i] = ONE


@njit(cache=True, nogil=True, error_model="numpy")
def any_live(buffer: np.ndarray) -> bool:
    """Whether a pixel of the tile is still open."""
    live = ZERO
    for i in range(LIVE, LIVE + PIXELS):
        live += buffer[i]
    return live > 0


@njit(cache=True, nogil=True, error_model="numpy")
def row_range(low: float, high: float, top: int) -> tuple:
    """First and last + 1 row of the tile whose pixel centres can lie in [low, high]."""
    first = max(low - _f(top) - HALF, ZERO)
    last = min(high - _f(top) - HALF, _f(TILE_H - 1))
    return int(np.ceil(first)), int(np.floor(last)) + 1
