"""The passes of demosaicking over a tile: numba kernels in single precision. See `carriers` for what they add up to.

A cell is a 2x2 block of polarisers under one colour; planes [h/2, w/2] have a value a cell, planes [h, w] one a sample.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.kernels.compiling import kernel

Plane = NDArray[np.float32]
Stack = NDArray[np.float32]
"""Planes of the K colours [K, h/2, w/2] (K is 3, or 1 of a monochrome sensor)."""
F = np.float32
TINY = F(1e-12)
"""Of bright light squared: below any light that a 16-bit code can tell (2e-10)."""


@kernel(nogil=True, fastmath=True)
def pool_light(mosaic: Plane, scale: np.float32, bayer: NDArray[np.int64], sparse: Stack) -> None:
    """Mean light of each cell (crossed pairs cancel the polarisation), in the plane of its colour; zero in the others."""
    for y in range(sparse.shape[1]):
        for x in range(sparse.shape[2]):
            top = mosaic[2 * y, 2 * x] + mosaic[2 * y, 2 * x + 1]
            light = scale * (top + mosaic[2 * y + 1, 2 * x] + mosaic[2 * y + 1, 2 * x + 1])
            own = bayer[y & 1, x & 1]
            for c in range(sparse.shape[0]):
                sparse[c, y, x] = light if c == own else F(0)


@kernel(nogil=True, fastmath=True)
def to_chroma(light: Stack, dim: np.float32, root: Stack) -> None:
    """Each colour's light over the mean of all, in place; and its square root."""
    for y in range(light.shape[1]):
        for x in range(light.shape[2]):
            r, g, b = max(light[0, y, x], F(0)), max(light[1, y, x], F(0)), max(light[2, y, x], F(0))
            over = F(1) / ((r + g + b) * F(1 / 3) + dim)
            r, g, b = (r + dim) * over, (g + dim) * over, (b + dim) * over
            light[0, y, x], light[1, y, x], light[2, y, x] = r, g, b
            root[0, y, x], root[1, y, x], root[2, y, x] = np.sqrt(r), np.sqrt(g), np.sqrt(b)


@kernel(nogil=True, fastmath=True, inline="always")
def _four(plane: Plane, y: int, x: int) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """A cell plane at the cell's four samples, bilinearly."""
    above, below = max(y - 1, 0), min(y + 1, plane.shape[0] - 1)
    left, right = max(x - 1, 0), min(x + 1, plane.shape[1] - 1)
    near, mid, far = F(9 / 16), F(3 / 16), F(1 / 16)
    n, w, e, s = plane[above, x], plane[y, left], plane[y, right], plane[below, x]
    here = near * plane[y, x]
    return (
        here + mid * (n + w) + far * plane[above, left],
        here + mid * (n + e) + far * plane[above, right],
        here + mid * (s + w) + far * plane[below, left],
        here + mid * (s + e) + far * plane[below, right],
    )


@kernel(nogil=True, fastmath=True)
def one_colour(mosaic: Plane, scale: np.float32, chroma: Stack, bayer: NDArray[np.int64], out: Plane) -> None:
    """Samples as a sensor without colour filters would have them: over the chroma of their own colour."""
    for y in range(chroma.shape[1]):
        for x in range(chroma.shape[2]):
            a, b, c, d = _four(chroma[bayer[y & 1, x & 1]], y, x)
            j, i = 2 * y, 2 * x
            out[j, i] = max(mosaic[j, i] * scale, F(0)) / a
            out[j, i + 1] = max(mosaic[j, i + 1] * scale, F(0)) / b
            out[j + 1, i] = max(mosaic[j + 1, i] * scale, F(0)) / c
            out[j + 1, i + 1] = max(mosaic[j + 1, i + 1] * scale, F(0)) / d


@kernel(nogil=True, fastmath=True, inline="always")
def _line(a: np.float32, b: np.float32, c: np.float32, d: np.float32) -> tuple[np.float32, np.float32, np.float32]:
    """(carrier, light, squared gradient) of a cell's samples b, c between neighbours a, d on a line.

    Each of b, c less the mean of its neighbours, signs +-; the same sum, signs ++; differences of equal polarisers.
    """
    apart, beside = F(1.5), F(0.5)
    return apart * (b - c) - beside * (a - d), apart * (b + c) + beside * (a + d), (c - a) * (c - a) + (d - b) * (d - b)


@kernel(nogil=True, fastmath=True)
def demodulate(
    light: Plane,
    root: Stack,
    bayer: NDArray[np.int64],
    edge: np.float32,
    colour_edge: np.float32,
    dark: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Both carriers over the light of each cell, and their weights: out [4] = weight, weighted ratio along x; along y.

    Weights fall with the light's gradient along the line (`edge`), with that of colour (`colour_edge`), and in the dark.
    """
    rows, columns = out.shape[1:]
    colours = root.shape[0]
    for y in range(rows):
        j, above, below = 2 * y, max(y - 1, 0), min(y + 1, rows - 1)
        up, down = max(2 * y - 1, 0), min(2 * y + 2, 2 * rows - 1)
        for x in range(columns):
            i, left, right = 2 * x, max(x - 1, 0), min(x + 1, columns - 1)
            back, on = max(2 * x - 1, 0), min(2 * x + 2, 2 * columns - 1)
            a, b, c, d = light[j, i], light[j, i + 1], light[j + 1, i], light[j + 1, i + 1]
            n1, t1, g1 = _line(light[j, back], a, b, light[j, on])
            n2, t2, g2 = _line(light[j + 1, back], c, d, light[j + 1, on])
            n3, t3, g3 = _line(light[up, i], a, c, light[down, i])
            n4, t4, g4 = _line(light[up, i + 1], b, d, light[down, i + 1])
            across, down_ = F(0), F(0)
            scale = F(1)
            if colours == 3:
                for k in range(3):
                    h, v = root[k, y, right] - root[k, y, left], root[k, below, x] - root[k, above, x]
                    across += h * h
                    down_ += v * v
                scale = np.sqrt(root[bayer[y & 1, x & 1], y, x])
            tx, ty = t1 + t2, t3 + t4
            sx, sy = tx * tx, ty * ty
            wx = sx / ((sx + edge * (g1 + g2) + TINY) * (F(1) + colour_edge * across) * (F(1) + dark / (sx + TINY)))
            wy = sy / ((sy + edge * (g3 + g4) + TINY) * (F(1) + colour_edge * down_) * (F(1) + dark / (sy + TINY)))
            out[0, y, x] = wx
            out[1, y, x] = wx * scale * (n1 + n2) / (tx + TINY)
            out[2, y, x] = wy
            out[3, y, x] = wy * scale * (n3 + n4) / (ty + TINY)


@kernel(nogil=True, fastmath=True)
def colour_terms(
    cells: NDArray[np.float32], sums: NDArray[np.float32], bayer: NDArray[np.int64], out: NDArray[np.float32]
) -> None:
    """Per-colour deviation of the cells [4, H, W] from the ratio of all colours (sums [4, H, W]).

    out [K, 4, H, W]: of each of K colours the weights and deviations along rows and along columns; 0 at cells of others.
    """
    for y in range(cells.shape[1]):
        for x in range(cells.shape[2]):
            own = bayer[y & 1, x & 1]
            wx, wy = cells[0, y, x], cells[2, y, x]
            rx = cells[1, y, x] - wx * sums[1, y, x] / (sums[0, y, x] + TINY)
            ry = cells[3, y, x] - wy * sums[3, y, x] / (sums[2, y, x] + TINY)
            for c in range(out.shape[0]):
                here = F(1) if c == own else F(0)
                out[c, 0, y, x] = here * wx
                out[c, 1, y, x] = here * rx
                out[c, 2, y, x] = here * wy
                out[c, 3, y, x] = here * ry


@kernel(nogil=True, fastmath=True, inline="always")
def _bounded(p: np.float32, q: np.float32, basis: NDArray[np.float32], most: np.float32) -> tuple[np.float32, np.float32]:
    """Carriers p, q as ratios, no longer than `most`."""
    u, v = basis[0, 0] * p + basis[0, 1] * q, basis[1, 0] * p + basis[1, 1] * q
    over = F(1) / max(np.sqrt(u * u + v * v) / most, F(1))
    return u * over, v * over


@kernel(nogil=True, fastmath=True)
def solve_ratios(
    sums: NDArray[np.float32],
    terms: NDArray[np.float32],
    root: Stack,
    unmix: NDArray[np.float32],
    basis: NDArray[np.float32],
    most: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Ratios (s1, s2) / s0 out [K, 2] from the windows' sums [4] and terms [K, 4]; no longer than `most`."""
    for y in range(sums.shape[1]):
        for x in range(sums.shape[2]):
            along = sums[1, y, x] / (sums[0, y, x] + TINY)
            down = sums[3, y, x] / (sums[2, y, x] + TINY)
            if out.shape[0] == 1:
                out[0, 0, y, x], out[0, 1, y, x] = _bounded(along, down, basis, most)
                continue
            over = F(1) / np.sqrt(root[0, y, x])
            r0 = over * (along + terms[0, 1, y, x] / (terms[0, 0, y, x] + TINY))
            r1 = over * (down + terms[0, 3, y, x] / (terms[0, 2, y, x] + TINY))
            over = F(1) / np.sqrt(root[1, y, x])
            g0 = over * (along + terms[1, 1, y, x] / (terms[1, 0, y, x] + TINY))
            g1 = over * (down + terms[1, 3, y, x] / (terms[1, 2, y, x] + TINY))
            over = F(1) / np.sqrt(root[2, y, x])
            b0 = over * (along + terms[2, 1, y, x] / (terms[2, 0, y, x] + TINY))
            b1 = over * (down + terms[2, 3, y, x] / (terms[2, 2, y, x] + TINY))
            for c in range(3):
                p = unmix[c, 0] * r0 + unmix[c, 1] * g0 + unmix[c, 2] * b0
                q = unmix[c, 0] * r1 + unmix[c, 1] * g1 + unmix[c, 2] * b1
                out[c, 0, y, x], out[c, 1, y, x] = _bounded(p, q, basis, most)


@kernel(nogil=True, fastmath=True)
def unpolarise(
    light: Plane, ratios: NDArray[np.float32], modulation: NDArray[np.float32], bayer: NDArray[np.int64], out: Plane
) -> None:
    """The light that each sample means, given its colour's ratios [K, 2] and modulation [4, 2] of the cell's samples."""
    for y in range(ratios.shape[2]):
        for x in range(ratios.shape[3]):
            own = ratios[bayer[y & 1, x & 1]]
            u, v = _four(own[0], y, x), _four(own[1], y, x)
            j, i = 2 * y, 2 * x
            out[j, i] = light[j, i] / (F(1) + u[0] * modulation[0, 0] + v[0] * modulation[0, 1])
            out[j, i + 1] = light[j, i + 1] / (F(1) + u[1] * modulation[1, 0] + v[1] * modulation[1, 1])
            out[j + 1, i] = light[j + 1, i] / (F(1) + u[2] * modulation[2, 0] + v[2] * modulation[2, 1])
            out[j + 1, i + 1] = light[j + 1, i + 1] / (F(1) + u[3] * modulation[3, 0] + v[3] * modulation[3, 1])


@kernel(nogil=True, fastmath=True)
def along_edges(image: Plane, dark: np.float32, out: Plane) -> None:
    """Edge-directed smoothing: 0.5 x + 0.5 (mean of 3 along the axis, row or column, with the smaller gradient)."""
    height, width = image.shape
    quarter, half = F(0.25), F(0.5)
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


@kernel(nogil=True, fastmath=True)
def write_tile(
    grey: Plane,
    chroma: Stack,
    ratios: NDArray[np.float32],
    level: np.float32,
    halo: int,
    wide: Plane,
    out: NDArray[np.float32],
) -> None:
    """`level` times light, chroma and ratios, both bilinear between cells, as Stokes out [rows, columns, 3, 3].

    `wide` [3 K, w / 2] is the workspace of a row of cells. The tile's planes reach `halo` samples further than `out`.
    """
    colours = chroma.shape[0]
    near, far = F(0.75), F(0.25)
    half = halo // 2
    for y in range(out.shape[0]):
        at = y + halo
        cell, other = at // 2, at // 2 + (1 if at & 1 else -1)
        for c in range(colours):
            for x in range(wide.shape[1]):
                wide[3 * c, x] = level * (near * chroma[c, cell, x] + far * chroma[c, other, x])
                wide[3 * c + 1, x] = near * ratios[c, 0, cell, x] + far * ratios[c, 0, other, x]
                wide[3 * c + 2, x] = near * ratios[c, 1, cell, x] + far * ratios[c, 1, other, x]
        for c in range(colours):
            tint, first, second = wide[3 * c], wide[3 * c + 1], wide[3 * c + 2]
            for n in range(out.shape[1] // 2):
                x = n + half
                for side in range(2):
                    to = x - 1 + 2 * side
                    s0 = max(grey[at, halo + 2 * n + side], F(0)) * (near * tint[x] + far * tint[to])
                    s1 = s0 * (near * first[x] + far * first[to])
                    s2 = s0 * (near * second[x] + far * second[to])
                    for k in range(c, c + 1 if colours == 3 else 3):
                        out[y, 2 * n + side, 0, k] = s0
                        out[y, 2 * n + side, 1, k] = s1
                        out[y, 2 * n + side, 2, k] = s2
