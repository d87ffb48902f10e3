"""The passes of the residual demosaicking over a band: arithmetic at each pixel, and the mean along edges."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]


@numba.njit(nogil=True, cache=True, fastmath=True)
def ratio_terms(double: Plane, s0: Plane, m1: Plane, m2: Plane, gain: np.float32, out: NDArray[np.float32]) -> None:
    """Terms of the normal equations at each sample, to be summed over windows: out[0:2] right side, [2:5] m11, m22, m12."""
    height, width = double.shape
    for y in range(height):
        for x in range(width):
            light = max(s0[y, x], np.float32(0))
            root = np.sqrt(light)
            residue = (double[y, x] - gain * light) * root
            weight = light * root
            u, v = m1[y, x], m2[y, x]
            out[0, y, x] = residue * u
            out[1, y, x] = residue * v
            out[2, y, x] = weight * u * u
            out[3, y, x] = weight * v * v
            out[4, y, x] = weight * u * v


@numba.njit(nogil=True, cache=True, fastmath=True)
def solve_ratios(
    sums: NDArray[np.float32],
    crossed: bool,
    double: Plane,
    m1: Plane,
    m2: Plane,
    gain: np.float32,
    dark: np.float32,
    most: np.float32,
    d1: Plane,
    d2: Plane,
    s0: Plane,
) -> None:
    """Ratios d = (s1, s2) / s0 of each window, at most `most` long, and the light that each sample then means."""
    height, width = double.shape
    one, shorter = np.float32(1), np.float32(1) / most
    for y in range(height):
        if crossed:
            for x in range(width):
                b11, b22, b12 = sums[2, y, x], sums[3, y, x], sums[4, y, x]
                det = one / (b11 * b22 - b12 * b12 + dark * dark)
                d1[y, x] = (sums[0, y, x] * b22 - sums[1, y, x] * b12) * det
                d2[y, x] = (sums[1, y, x] * b11 - sums[0, y, x] * b12) * det
        else:
            for x in range(width):
                d1[y, x] = sums[0, y, x] / (sums[2, y, x] + dark)
                d2[y, x] = sums[1, y, x] / (sums[3, y, x] + dark)
        for x in range(width):
            u, v = d1[y, x], d2[y, x]
            over = one / max(np.sqrt(u * u + v * v) * shorter, one)
            u *= over
            v *= over
            d1[y, x] = u
            d2[y, x] = v
            s0[y, x] = double[y, x] / (gain + u * m1[y, x] + v * m2[y, x])


@numba.njit(nogil=True, cache=True, fastmath=True)
def along_edges(image: Plane, dark: np.float32, out: Plane) -> None:
    """Half of each pixel and half of the mean of three along its row or column, whichever changes less."""
    height, width = image.shape
    quarter, half = np.float32(0.25), np.float32(0.5)
    for y in range(height):
        above, below = abs(y - 1), y + 1 if y + 1 < height else height - 2
        out[y, 0] = image[y, 0]
        out[y, width - 1] = image[y, width - 1]
        for x in range(1, width - 1):
            a, b, c = image[above, x - 1], image[above, x], image[above, x + 1]
            d, e, f = image[y, x - 1], image[y, x], image[y, x + 1]
            g, h, i = image[below, x - 1], image[below, x], image[below, x + 1]
            across = quarter * (c - a) + half * (f - d) + quarter * (i - g)
            down = quarter * (g - a) + half * (h - b) + quarter * (i - c)
            across, down = across * across, down * down
            row, column = half * e + quarter * (d + f), half * e + quarter * (b + h)
            share = (down + dark) / (across + down + dark + dark)
            out[y, x] = half * (e + column + share * (row - column))


@numba.njit(nogil=True, cache=True)
def to_stokes(s0: Plane, s1: Plane, s2: Plane, halo: int, out: NDArray[np.float32]) -> None:
    """Planes with `halo` pixels around them to a grey Stokes tile [h, w, 3, 3]."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            a, b, d = s0[y + halo, x + halo], s1[y + halo, x + halo], s2[y + halo, x + halo]
            for c in range(3):
                out[y, x, 0, c] = a
                out[y, x, 1, c] = b
                out[y, x, 2, c] = d
