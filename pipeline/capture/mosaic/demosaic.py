"""Polarisation-sensor mosaics (2x2 polarisers, monochrome or quad-Bayer) to Stokes images.

`bilinear` interpolates each angle (and colour) on its own: at edges the four angles see different places and a false
polarisation appears. `carriers` demodulates instead (see that module); it needs crossed polarisers on the diagonals of a
2x2 block, as every polarisation sensor has them, and other orders are left to `bilinear`.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.capture.angle_stack.solve import polariser_design
from pipeline.capture.mosaic.carriers import HALO, bright_level, carries, solve_tile
from pipeline.capture.pixels.frame_memory import frame_array

Plane = NDArray[Any]
ROWS, COLUMNS = 512, 1024
"""Of a tile: small enough for the cache, large enough that its margin costs little."""
TENT = np.array([0.5, 1, 0.5], np.float32)


def demosaic(
    mosaic: Plane,
    order: Sequence[float],
    colour: str = "mono",
    bayer: str = "RGGB",
    method: str = "carriers",
    extinction: float | None = None,
    threads: int = 2,
) -> Plane:
    """Stokes [H, W, 3, 3] of a mosaic [H, W]; `order`: angles (degrees) of a 2x2 block, row by row.

    `colour`: "mono" (the three colours are alike) or "bayer" (2x2 polarisers under each colour of `bayer`).
    Borders are mirrored at whole blocks. Sides must be even (quad-Bayer: multiples of 4).
    """
    height, width = mosaic.shape
    block = 4 if colour == "bayer" else 2
    if height % block or width % block:
        raise ValueError(f"a mosaic of {width}x{height} does not consist of whole {block}x{block} blocks")
    halo = HALO[colour]
    rows, columns = (_mirrored(n, halo, block) for n in mosaic.shape)
    colours = bayer if colour == "bayer" else ""
    level = bright_level(mosaic)
    bilinear = method == "bilinear" or not carries(order)
    out = frame_array((height, width, 3, 3))

    def tile(corner: tuple[int, int]) -> None:
        top, left = corner
        bottom, right = min(top + ROWS, height), min(left + COLUMNS, width)
        within = halo <= top and bottom + halo <= height and halo <= left and right + halo <= width
        around = np.ix_(rows[top : bottom + 2 * halo], columns[left : right + 2 * halo])
        samples = mosaic[top - halo : bottom + halo, left - halo : right + halo] if within else mosaic[around]
        samples = np.ascontiguousarray(samples, np.float32)
        part = out[top:bottom, left:right]
        if bilinear:
            for c, plane in enumerate(_colour_planes(samples, bayer) if colours else [samples]):
                stokes = np.stack(_bilinear(plane, order, extinction), -1)[halo : halo + len(part), halo : halo + part.shape[1]]
                part[..., c : c + 1 if colours else 3] = stokes[..., None]
        else:
            solve_tile(samples, order, colours, extinction, level, halo, part)

    corners = [(y, x) for y in range(0, height, ROWS) for x in range(0, width, COLUMNS)]
    with ThreadPoolExecutor(max(1, threads)) as pool:
        list(pool.map(tile, corners))
    return out


def _mirrored(n: int, halo: int, block: int) -> NDArray[np.int64]:
    """Where the samples -halo .. n + halo of a line of n are found: mirrored in whole blocks, so that the pattern goes on."""
    blocks = np.arange(-halo // block, (n + halo) // block)
    count = n // block
    folded = np.abs((blocks + count) % (2 * count) - count) if count > 1 else np.zeros_like(blocks)
    folded = np.where(blocks < 0, -blocks - 1, np.where(blocks >= count, 2 * count - 1 - blocks, folded))
    folded = np.clip(np.where((blocks >= 0) & (blocks < count), blocks, folded), 0, count - 1)
    where: NDArray[np.int64] = (folded[:, None] * block + np.arange(block)).ravel()
    return where


def _tent(image: Plane) -> Plane:
    return cv2.sepFilter2D(image, cv2.CV_32F, TENT, TENT, borderType=cv2.BORDER_REFLECT_101)


def _bilinear(mosaic: Plane, order: Sequence[float], extinction: float | None) -> list[Plane]:
    """(s0, s1, s2) from each angle interpolated bilinearly on its own."""
    planes = []
    for row in range(2):
        for column in range(2):
            sparse = np.zeros_like(mosaic)
            sparse[row::2, column::2] = mosaic[row::2, column::2]
            planes.append(_tent(sparse))
    solver = np.linalg.pinv(polariser_design(order, extinction)).astype(np.float32)
    return [sum(solver[k, i] * plane for i, plane in enumerate(planes)) for k in range(3)]


def _colour_planes(mosaic: Plane, bayer: str) -> list[Plane]:
    """Quad-Bayer [h, w] to three monochrome polariser mosaics, each angle's samples of a colour interpolated bilinearly."""
    planes = [np.empty_like(mosaic) for _ in range(3)]
    for row in range(2):
        for column in range(2):
            image = np.ascontiguousarray(mosaic[row::2, column::2])
            for colour, plane in zip("RGB", planes):
                at = np.array([c == colour for c in bayer.upper()], np.float32).reshape(2, 2)
                there = np.tile(at, (image.shape[0] // 2, image.shape[1] // 2))
                plane[row::2, column::2] = _tent(image * there) / _tent(there)
    return planes
