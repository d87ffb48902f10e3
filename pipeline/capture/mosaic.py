"""Polarisation-sensor mosaics (2x2 polarisers, monochrome or quad-Bayer) to Stokes images.

`bilinear` interpolates each angle (and colour) on its own: at edges the four angles see different places and a false
polarisation appears. `residual` uses that polarisation *per light* is smoother than light: with a mosaic sample
I = (s0 + s1 c + s2 s) / 2 and s1 = d1 s0, s2 = d2 s0, the ratios d are a local least-squares fit on an estimate of s0,
and s0 then follows from every single sample as 2 I / (1 + d1 c + d2 s), at full resolution; two rounds of that.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.capture.frame_memory import frame_array
from pipeline.capture.stack import polariser_design

Plane = NDArray[Any]
ROWS, COLUMNS = 256, 512
"""Of a tile: its planes stay in the cache."""
HALO = {"mono": 8, "bayer": 16}
"""Pixels of context around a tile: whole blocks, and more than the reach of all filters together (6; of a colour's, 15)."""
NEIGHBOURS = np.array([0.25, 0.5, 0.25], np.float32)
WINDOWS = (np.array([1, 2, 3, 2, 1], np.float32) / 9, NEIGHBOURS)
"""Of the ratios' fit, a round each. Samples weigh as s0^1.5, between what noise of the light (s0) and of the sensor (s0^2)
ask for; wider windows and more rounds were measured to be worse."""
COLOUR_ROUNDS = 2
COLOUR_WINDOW = np.array([1, 2, 3, 4, 3, 2, 1], np.float32) / 16
"""Of a quad-Bayer colour, whose samples come in 2x2 blocks every four pixels: every window holds each angle alike.
DoLP error below bilinear: 4.2 dB on sharp texture, 3.0 and 2.6 on two renders (three rounds: 5.8, 2.8, 2.5; a window of five:
2.0, 2.1, 1.5; bilinear colours with each colour's own residual fit: 2.4, 0.8, 1.5; with Malvar's colours: -0.3, 0.3, -0.6)."""
DIM = np.float32(1e-4)
"""Of full scale: light below which colours are taken for grey, as noise has none."""
DARK = np.float32(1e-12)
"""Of full scale squared: a window this dark holds no polarisation to speak of (a 16-bit code squared is 2e-10)."""
MAX_RATIO = 0.98
"""Keeps 1 + d·m off zero: a crossed, fully polarised sample says nothing of the light."""


def demosaic(
    mosaic: Plane,
    order: Sequence[float],
    colour: str = "mono",
    bayer: str = "RGGB",
    method: str = "residual",
    extinction: float | None = None,
    threads: int = 2,
) -> Plane:
    """Stokes [H, W, 3, 3] of a mosaic [H, W]; `order`: angles (degrees) of a 2x2 block, row by row.

    `colour`: "mono" (the three colours are alike) or "bayer" (2x2 polarisers under each colour of `bayer`).
    Borders are mirrored at whole blocks. Sides must be even (quad-Bayer: multiples of 4).
    """
    from pipeline.capture.mosaic_kernels import to_stokes

    height, width = mosaic.shape
    block = 4 if colour == "bayer" else 2
    if height % block or width % block:
        raise ValueError(f"a mosaic of {width}x{height} does not consist of whole {block}x{block} blocks")
    halo = HALO[colour]
    padded = _mirror_blocks(mosaic, halo, block)
    solve = _bilinear_band if method == "bilinear" else _residual_band
    out = frame_array((height, width, 3, 3))

    def colours(samples: Plane) -> Iterable[list[Plane]]:
        if method == "bilinear":
            return (_bilinear_band(plane, order, extinction) for plane in _colour_planes(samples, bayer))
        return _residual_quad_bayer(samples, order, bayer, extinction)

    def tile(corner: tuple[int, int]) -> None:
        top, left = corner
        bottom, right = min(top + ROWS, height), min(left + COLUMNS, width)
        samples = padded[top : bottom + 2 * halo, left : right + 2 * halo]
        inner = (slice(halo, halo + bottom - top), slice(halo, halo + right - left))
        part = out[top:bottom, left:right]
        if colour == "bayer":
            for c, planes in enumerate(colours(samples)):
                for k, solved in enumerate(planes):
                    part[:, :, k, c] = solved[inner]
        else:
            s0, s1, s2 = solve(samples, order, extinction)
            to_stokes(s0, s1, s2, halo, part)

    corners = [(y, x) for y in range(0, height, ROWS) for x in range(0, width, COLUMNS)]
    with ThreadPoolExecutor(max(1, threads)) as pool:
        list(pool.map(tile, corners))
    return out


def _mirror_blocks(mosaic: Plane, halo: int, block: int) -> Plane:
    """Mirrored in whole blocks at the borders, so that the pattern goes on."""
    height, width = mosaic.shape

    def index(n: int) -> NDArray[Any]:
        blocks = np.arange(-halo // block, (n + halo) // block)
        count = n // block
        folded = np.abs((blocks + count) % (2 * count) - count) if count > 1 else np.zeros_like(blocks)
        folded = np.where(blocks < 0, -blocks - 1, np.where(blocks >= count, 2 * count - 1 - blocks, folded))
        folded = np.clip(np.where((blocks >= 0) & (blocks < count), blocks, folded), 0, count - 1)
        return (folded[:, None] * block + np.arange(block)).ravel()

    return np.ascontiguousarray(mosaic[index(height)][:, index(width)])


def _filter(image: Plane, taps: Plane) -> Plane:
    return cv2.sepFilter2D(image, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_REFLECT_101)


@lru_cache(maxsize=8)
def _modulation(
    shape: tuple[int, int], order: tuple[float, ...], extinction: float | None
) -> tuple[Plane, Plane, np.float32, bool]:
    """2 I = gain s0 + m1 s1 + m2 s2 at each pixel of [h, w]: (m1, m2, gain, whether m1 m2 is anywhere other than zero)."""
    rows = 2 * polariser_design(order, extinction).reshape(2, 2, 3)
    rows[np.abs(rows) < 1e-6] = 0  # an ideal order has cosines of 1e-17 in place of zeros
    tiles = np.tile(rows, (shape[0] // 2, shape[1] // 2, 1)).astype(np.float32)
    crossed = bool(np.abs(rows[..., 1] * rows[..., 2]).max() > 0)
    return np.ascontiguousarray(tiles[..., 1]), np.ascontiguousarray(tiles[..., 2]), np.float32(rows[0, 0, 0]), crossed


_own = threading.local()


def _scratch(shape: tuple[int, int]) -> tuple[Plane, list[Plane]]:
    """This thread's planes [5, h, w] and five [h, w], reused from band to band."""
    planes = getattr(_own, "planes", None)
    if planes is None or planes.shape[1:] != shape:
        planes = _own.planes = np.empty((10, *shape), np.float32)
    return planes[:5], list(planes[5:])


def _residual_band(mosaic: Plane, order: Sequence[float], extinction: float | None) -> list[Plane]:
    """(s0, s1, s2) [h, w] of a band with whole blocks, in this thread's scratch planes."""
    from pipeline.capture.mosaic_kernels import along_edges, ratio_terms, solve_ratios

    m1, m2, gain, crossed = _modulation(mosaic.shape, tuple(order), extinction)
    terms, (double, s0, d1, d2, rough) = _scratch(mosaic.shape)
    np.multiply(mosaic, np.float32(2), out=double)
    cv2.sepFilter2D(double, cv2.CV_32F, NEIGHBOURS, NEIGHBOURS, dst=s0, borderType=cv2.BORDER_REFLECT_101)
    s0 /= gain
    for taps in WINDOWS:
        ratio_terms(double, s0, m1, m2, gain, terms)
        for term in terms[: 5 if crossed else 4]:
            cv2.sepFilter2D(term, cv2.CV_32F, taps, taps, dst=term, borderType=cv2.BORDER_REFLECT_101)
        solve_ratios(terms, crossed, double, m1, m2, gain, DARK, np.float32(MAX_RATIO), d1, d2, rough)
        along_edges(rough, DARK, s0)
    d1 *= s0
    d2 *= s0
    return [s0, d1, d2]


def _bilinear_band(mosaic: Plane, order: Sequence[float], extinction: float | None) -> list[Plane]:
    """(s0, s1, s2) from each angle interpolated bilinearly on its own."""
    taps = np.array([0.5, 1, 0.5], np.float32)
    planes = []
    for row in range(2):
        for column in range(2):
            sparse = np.zeros_like(mosaic)
            sparse[row::2, column::2] = mosaic[row::2, column::2]
            planes.append(_filter(sparse, taps))
    solver = np.linalg.pinv(polariser_design(order, extinction)).astype(np.float32)
    return [sum(solver[k, i] * plane for i, plane in enumerate(planes)) for k in range(3)]


def _colour_planes(mosaic: Plane, bayer: str) -> list[Plane]:
    """Quad-Bayer [h, w] to three monochrome polariser mosaics, each angle's samples of a colour interpolated bilinearly."""
    planes = [np.empty_like(mosaic) for _ in range(3)]
    tent = np.array([0.5, 1, 0.5], np.float32)
    for row in range(2):
        for column in range(2):
            image = np.ascontiguousarray(mosaic[row::2, column::2])
            for colour, plane in zip("RGB", planes):
                at = np.array([c == colour for c in bayer.upper()], np.float32).reshape(2, 2)
                there = np.tile(at, (image.shape[0] // 2, image.shape[1] // 2))
                plane[row::2, column::2] = _filter(image * there, tent) / _filter(there, tent)
    return planes


def _residual_quad_bayer(mosaic: Plane, order: Sequence[float], bayer: str, extinction: float | None) -> list[list[Plane]]:
    """(s0, s1, s2) [h, w] of each colour: the light of all samples, made one colour, has the sensor's full resolution.

    A round: the ratios of a colour give the light at its samples; chroma, which is smooth, makes one picture of all;
    that picture times chroma is each colour's light everywhere, on which its ratios are fitted again, on its own samples.
    """
    from pipeline.capture.mosaic_kernels import along_edges, ratio_terms, solve_ratios

    m1, m2, gain, crossed = _modulation(mosaic.shape, tuple(order), extinction)
    terms, (double, grey, d1, d2, rough) = _scratch(mosaic.shape)
    np.multiply(mosaic, np.float32(2), out=double)
    where = [_positions(mosaic.shape, colour, bayer.upper(), tuple(order), extinction) for colour in "RGB"]
    light = double / gain
    for number in range(COLOUR_ROUNDS):
        means = [_filter(light * at.here, COLOUR_WINDOW) * at.over_share for at in where]
        mean = (means[0] + means[1] + means[2]) / np.float32(3) + DIM
        chroma = [np.maximum(m + DIM, DIM) / mean for m in means]
        np.divide(light, sum(c * at.here for c, at in zip(chroma, where)), out=rough)
        if number == 0:
            cv2.sepFilter2D(rough, cv2.CV_32F, NEIGHBOURS, NEIGHBOURS, dst=grey, borderType=cv2.BORDER_REFLECT_101)
        else:
            along_edges(rough, DARK, grey)
        np.maximum(grey, 0, out=grey)
        solved = []
        for at, c in zip(where, chroma):
            s0 = np.asarray(grey * c, np.float32)
            ratio_terms(double, s0, at.m1, at.m2, gain, terms)
            for term in terms[: 5 if crossed else 4]:
                cv2.sepFilter2D(term, cv2.CV_32F, COLOUR_WINDOW, COLOUR_WINDOW, dst=term, borderType=cv2.BORDER_REFLECT_101)
            solve_ratios(terms, crossed, double, m1, m2, gain, DARK, np.float32(MAX_RATIO), d1, d2, rough)
            if number < COLOUR_ROUNDS - 1:
                np.copyto(light, np.maximum(rough, 0), where=at.mask)
            else:
                solved.append([s0, d1 * s0, d2 * s0])
    return solved


@dataclass(frozen=True)
class _Positions:
    """Where [h, w] quad-Bayer has samples of a colour: 1 or 0, the same as bool, one over their share of each window, and
    the modulation there."""

    here: Plane
    mask: Plane
    over_share: Plane
    m1: Plane
    m2: Plane


@lru_cache(maxsize=24)
def _positions(
    shape: tuple[int, int], colour: str, bayer: str, order: tuple[float, ...], extinction: float | None
) -> _Positions:
    at = np.kron(np.array([c == colour for c in bayer], np.float32).reshape(2, 2), np.ones((2, 2), np.float32))
    here = np.ascontiguousarray(np.tile(at, (shape[0] // 4, shape[1] // 4)))
    m1, m2, _, _ = _modulation(shape, order, extinction)
    return _Positions(here, here > 0, 1 / _filter(here, COLOUR_WINDOW), m1 * here, m2 * here)
