"""Polariser mosaics to Stokes images by demodulation: the polarisation of light rides on the finest stripes of a mosaic.

Where crossed polarisers share the diagonals of a 2x2 cell, a sample is light (1 + p u + q v) with u = +- along its row,
v = +- down its column, and p, q a fixed turn of the ratios (s1, s2) / s0: light is the baseband, p and q ride on carriers
at the two Nyquist frequencies (Tyo, LaCasse & Ratliff, Opt. Lett. 34, 2009). A vertical edge disturbs only the carrier
along rows: p is measured along rows, weighed down where samples of one polariser differ along the row; q along columns.
Both are then averaged over windows of cells, by weight, and the light follows from every single sample, at full resolution.

Quad-Bayer: samples are first brought to one colour by chroma, which is smooth. As half of each cell's neighbours have
another colour, its ratio is 3/4 its own and 1/4 theirs: the ratios of all cells in a small window, then what each colour's
cells differ from it in a larger window, then unmixed. Mirrored light is polarised alike in all colours, scattered light in
proportion to each: ratios are compared times chroma^1/4, between the two.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.capture.angle_stack.solve import polariser_design

Plane = NDArray[Any]
EDGE = np.float32(40.0)
"""How fast a cell's weight falls with (differences of equal polarisers / sum of their light) squared."""
COLOUR_EDGE = np.float32(7.5)
"""The same of the difference across two cells of the root of chroma, squared."""
BRIGHT_PCT, EVERY = 99.5, 9
"""The percentile of every 9th sample, each way, that the levels below are relative to: units do not matter."""
DARK = np.float32(1e-3)
"""Square of the light of a whole line of samples, of bright light, below which a cell is taken for noise: (8 x 0.004)^2."""
DIM = np.float32(1e-4)
"""Of bright light: light below which colours are taken for grey, as noise has none."""
MAX_RATIO = np.float32(0.98)
"""Keeps 1 + p u + q v off zero: a crossed, fully polarised sample says nothing of the light."""
CROSSED_DEG = 3.0
"""From 90 degrees: what calibration may find; the light then errs by up to 3 % of its polarised part."""
EVEN = np.float32(1e-12)
"""Of bright light squared: gradients below it have no direction (a 16-bit code squared is 2e-10)."""


def _taps(*values: float) -> Plane:
    return np.array(values, np.float32) / np.float32(sum(values))


CHROMA_WINDOW = _taps(1, 2, 1)
MONO_WINDOW = _taps(1, 4, 1)
COMMON_WINDOW = _taps(1, 4, 6, 4, 1)
COLOUR_WINDOW = _taps(1, 2, 3, 4, 3, 2, 1)
MIXTURE = np.array([[3 / 4, 1 / 4, 0], [1 / 8, 3 / 4, 1 / 8], [0, 1 / 4, 3 / 4]])
"""Of the ratios of red, green and blue in what a cell of each measures: half the neighbours of red and blue are green."""
HALO = {"mono": 8, "bayer": 20}
"""Samples of context around a tile, whole blocks: more than the reach of all filters together."""


def carries(order: Sequence[float]) -> bool:
    """True if both diagonals of the 2x2 cell hold polarisers 90 degrees apart (within CROSSED_DEG) and the pairs differ."""
    crossed = all(abs((order[a] - order[b]) % 180 - 90) < CROSSED_DEG for a, b in ((0, 3), (1, 2)))
    return crossed and 10 < (order[0] - order[1]) % 90 < 80


@lru_cache(maxsize=8)
def _basis(order: tuple[float, ...], extinction: float | None) -> tuple[np.float32, Plane, Plane]:
    """(light per twice a sample, ratios from p and q [2, 2], modulation of a cell's samples [4, 2])."""
    rows = 2 * polariser_design(order, extinction)
    gain = rows[0, 0]
    modulation = rows[:, 1:] / gain
    u, v = np.array([1, -1, 1, -1]), np.array([1, 1, -1, -1])
    inverse = np.linalg.inv(np.stack([u @ modulation, v @ modulation]) / 4)
    return np.float32(2 / gain), np.ascontiguousarray(inverse, np.float32), np.ascontiguousarray(modulation, np.float32)


@dataclass(frozen=True)
class _Cells:
    """Per-tile constants: the Bayer colour index of each cell of a 2x2 block, 1 / (share of CHROMA_WINDOW that a colour covers)
    [3, H, W], and the inverse of MIXTURE."""

    bayer: NDArray[np.int64]
    over_share: Plane
    unmix: Plane


@lru_cache(maxsize=8)
def _cells(shape: tuple[int, int], bayer: str) -> _Cells:
    colours = np.array(["RGB".index(c) for c in bayer.upper()], np.int64).reshape(2, 2) if bayer else np.zeros((2, 2), np.int64)
    tiled = np.tile(colours, (shape[0] // 2, shape[1] // 2))
    share = [_filter((tiled == c).astype(np.float32), CHROMA_WINDOW) for c in range(3 if bayer else 0)]
    return _Cells(colours, np.array([1 / s for s in share], np.float32), np.linalg.inv(MIXTURE).astype(np.float32))


_own = threading.local()


def _scratch(name: str, shape: tuple[int, ...]) -> Plane:
    """This thread's array of that name, reused from tile to tile."""
    held = vars(_own)
    if name not in held or held[name].shape != shape:
        held[name] = np.empty(shape, np.float32)
    found: Plane = held[name]
    return found


def _filter(image: Plane, taps: Plane, out: Plane | None = None) -> Plane:
    return cv2.sepFilter2D(image, cv2.CV_32F, taps, taps, dst=out, borderType=cv2.BORDER_REFLECT)


def bright_level(mosaic: Plane) -> float:
    """Bright light of a mosaic [H, W]; 1 where it is black."""
    level = float(np.percentile(mosaic[::EVERY, ::EVERY], BRIGHT_PCT))  # an odd step: samples of every kind
    return level if level > 0 else float(mosaic.max(initial=0)) or 1.0


def solve_tile(
    samples: Plane, order: Sequence[float], bayer: str, extinction: float | None, level: float, halo: int, out: Plane
) -> None:
    """Stokes out [h - 2 halo, w - 2 halo, 3, 3] of mosaic samples [h, w]; `bayer` names a block's colours, "": none.

    `level`: see `bright_level`.
    """
    from pipeline.capture.mosaic import demosaic_kernels

    scale, basis, modulation = _basis(tuple(order), extinction)
    scale /= np.float32(level)
    cells = (samples.shape[0] // 2, samples.shape[1] // 2)
    at = _cells(cells, bayer)
    colours = 3 if bayer else 1
    light, even, grey = _scratch("samples", (3, *samples.shape))
    chroma, root = _scratch("chroma", (2, colours, *cells))
    parts, sums = _scratch("parts", (2, 4, *cells))
    terms = _scratch("terms", (colours, 4, *cells))
    ratios = _scratch("ratios", (colours, 2, *cells))
    if bayer:
        demosaic_kernels.pool_light(samples, scale / np.float32(4), at.bayer, chroma)
        for c in range(3):
            _filter(chroma[c], CHROMA_WINDOW, chroma[c])
        chroma *= at.over_share
        demosaic_kernels.to_chroma(chroma, DIM, root)
        demosaic_kernels.one_colour(samples, scale, chroma, at.bayer, light)
    else:
        chroma[...] = root[...] = 1
        np.multiply(samples, scale, out=light)
        np.maximum(light, 0, out=light)
    demosaic_kernels.demodulate(light, root, at.bayer, EDGE, COLOUR_EDGE, DARK, parts)
    for k in range(4):
        _filter(parts[k], COMMON_WINDOW if bayer else MONO_WINDOW, sums[k])
    if bayer:
        demosaic_kernels.colour_terms(parts, sums, at.bayer, terms)
        for plane in terms.reshape(12, *cells):
            _filter(plane, COLOUR_WINDOW, plane)
    demosaic_kernels.solve_ratios(sums, terms, root, at.unmix, basis, MAX_RATIO, ratios)
    demosaic_kernels.unpolarise(light, ratios, modulation, at.bayer, even)
    demosaic_kernels.along_edges(even, EVEN, grey)
    demosaic_kernels.write_tile(grey, chroma, ratios, np.float32(level), halo, _scratch("row", (3 * colours, cells[1])), out)
