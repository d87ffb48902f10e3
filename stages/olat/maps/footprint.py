"""Widths of the surface from widths of the pixel: a pixel sees normals that differ, and its lobe is wider by their spread.

A lobe's width matrix (sigma squared) is twice the covariance of the slopes; the slopes of the footprint add theirs (Olano and
Baker 2010, LEAN mapping, read backwards). The spread below a pixel is estimated from the squared differences D1, D2 between the
normals of neighbours one and two pixels away. Pixels are box filters: of a wave of f cycles a pixel, 1 - s of the power lies
below them, s 2(1 - cos 2 pi f) in D1 and s 2(1 - cos 4 pi f) in D2, s = sinc²(f). `NEAR D1 + FAR D2` is the first for smooth
surfaces (f to 0: D1/12, a uniform spread) and for f = 1/4, and close to it in between: rough ones hide more below a pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from stages.olat.maps.tangents import EDGE, borne_out
from stages.olat.pixel_fit.fit_options import ROUND
from stages.olat.pixel_fit.result_layout import map_slices
from stages.olat.reading.scanline_bands import Band

LEAST = 0.25  # of a pixel's squared width that the surface keeps: the spread is an estimate of its own
SMOOTH = 1.0 / 12.0  # variance of a uniform distribution over its width squared
NEAR = np.pi**2 / 8 - 1 - SMOOTH
FAR = (SMOOTH - NEAR) / 4
CONTEXT = 2  # rows above and below that a pixel's spread depends on


def surface_widths(rows: NDArray[np.float64], spread: NDArray[np.float64]) -> None:
    """Take the spread of normals [P, 3, 3] (covariance, rad²) out of sigma, tangent, roughness and anisotropy, in place."""
    at = map_slices()
    sigma, tangent, normal = (rows[:, at[name]] for name in ("sigma", "tangent", "specular_normal"))
    one_way = np.linalg.norm(tangent, axis=1) > 0.5
    both = np.trace(spread, axis1=1, axis2=2)  # mean variance of the two axes, times two
    squares = np.maximum(sigma**2 - both[:, None], LEAST * sigma**2)
    t = tangent[one_way]
    axes = np.stack([t, np.cross(normal[one_way], t)], 1)
    across = 2 * axes @ spread[one_way] @ axes.transpose(0, 2, 1)
    # whiten by the pixel's widths: there the spread's eigenvalues say how much of the pixel's width it explains
    scale = 1.0 / np.maximum(sigma[one_way], 1e-9)
    value, vector = np.linalg.eigh(across * scale[:, :, None] * scale[:, None, :])
    kept = np.maximum(1.0 - value, LEAST)
    matrix = np.einsum("pij,pj,pkj->pik", vector, kept, vector) * sigma[one_way][:, :, None] * sigma[one_way][:, None, :]
    value, vector = np.linalg.eigh(matrix)
    squares[one_way] = value[:, ::-1]
    axis = vector[:, :, 1]  # of the larger width
    tangent[one_way] = axis[:, :1] * t + axis[:, 1:] * axes[:, 1]
    before = np.sqrt((sigma**2).mean(1))
    sigma[:] = np.sqrt(squares)
    after = np.sqrt((sigma**2).mean(1))
    rows[:, at["std_sigma"]] *= np.divide(before, after, out=np.ones_like(after), where=after > 0)[:, None]
    large, small = sigma[:, 0], sigma[:, 1]
    tangent[large - small <= ROUND * (large + small)] = 0.0
    rows[:, at["roughness"]] = ((large * small) ** 0.25)[:, None]
    rows[:, at["anisotropy"]] = np.divide(large - small, large + small, out=np.zeros_like(large), where=large > 0)[:, None]


def spreads(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance [H, W, 3, 3] (rad²) of the normals below each pixel, from their map [H, W, 3] (0 outside the object)."""
    near = _mean_square(normals, 1, lambda step: step[..., :, None] * step[..., None, :])
    size = np.trace(near, axis1=2, axis2=3)
    beyond = _mean_square(normals, 2, lambda step: np.sum(step * step, -1))
    ratio = np.divide(beyond, size, out=np.full_like(size, 4.0), where=(size > 0) & (beyond > 0))
    return (NEAR + FAR * np.minimum(ratio, 4.0))[..., None, None] * near  # 4: smooth; above it the surface only bends


def _mean_square(normals: NDArray[np.float64], lag: int, square: Callable[[NDArray], NDArray]) -> NDArray[np.float64]:
    """Sum over both axes of the mean `square` of the differences to the neighbours `lag` pixels away [H, W, ...]."""
    inside = np.any(normals != 0, -1)
    total = np.zeros((*inside.shape, *square(normals[:1, :1]).shape[2:]))
    for axis in (0, 1):
        length = normals.shape[axis]
        if length <= lag:
            continue
        turned, within = np.moveaxis(normals, axis, 0), np.moveaxis(inside, axis, 0)
        a, b = turned[lag:], turned[:-lag]
        fine = within[lag:] & within[:-lag] & (np.einsum("...k,...k->...", a, b) > EDGE)
        value = square(np.where(fine[..., None], a - b, 0.0))
        count = np.zeros(within.shape)
        count[lag:] += fine
        count[:-lag] += fine
        weight = (1.0 / np.maximum(count, 1.0)).reshape(*count.shape, *[1] * (value.ndim - 2))
        out = np.moveaxis(total, axis, 0)
        out[lag:] += value * weight[lag:]
        out[:-lag] += value * weight[:-lag]
    return total


def with_neighbours(
    bands: Iterable[tuple[Band, NDArray[np.float64]]], width: int, surface: bool = True
) -> Iterator[tuple[Band, NDArray[np.float64]]]:
    """The bands (pixels [P] of a frame `width` wide, rows [P, WIDTH]) with what depends on neighbours, each a little late.

    Tangents that are not borne out go; with `surface`, widths become the surface's. Rows of the bands above and below give the
    edges their neighbours: the result does not depend on the bands' size.
    """
    waiting: list[tuple[Band, NDArray[np.float64]]] = []
    known, at = _Rows(width), map_slices()
    for band, rows in bands:
        known.add(band, np.column_stack([rows[:, at["normal"]], rows[:, at["tangent"]].any(1)]))
        waiting.append((band, rows))
        while waiting and waiting[0][0].bottom + CONTEXT <= band.bottom:
            yield _finish(*waiting.pop(0), known, surface)
    for band, rows in waiting:
        yield _finish(band, rows, known, surface)


class _Rows:
    """The last rows of the map of normals and of who has a tangent [H, W, 4], 0 where nothing is known."""

    def __init__(self, width: int) -> None:
        self.top, self.image = 0, np.zeros((0, width, 4))

    def add(self, band: Band, found: NDArray[np.float64]) -> None:
        """Append what was found for a band [P, 4]; `bottom` rows above it that no pixel fills stay 0."""
        width = self.image.shape[1]
        if not len(self.image):
            self.top = max(self.top, band.top)  # what lies above the object is not kept
        rows = np.zeros((band.bottom - self.top - len(self.image), width, 4))
        rows.reshape(-1, 4)[band.pixels - (self.top + len(self.image)) * width] = found
        self.image = np.concatenate([self.image, rows])

    def between(self, top: int, bottom: int) -> NDArray[np.float64]:
        """Rows [top, bottom), and forget those above."""
        self.image, self.top = self.image[max(top - self.top, 0) :], max(top, self.top)
        out = np.zeros((bottom - top, *self.image.shape[1:]))
        part = self.image[: bottom - self.top]
        out[self.top - top : self.top - top + len(part)] = part
        return out


def _finish(
    band: Band, rows: NDArray[np.float64], known: _Rows, surface: bool
) -> tuple[Band, NDArray[np.float64]]:  # fmt: skip
    top, bottom = band.top - CONTEXT, band.bottom + CONTEXT
    found = known.between(top, bottom)
    normals, directed = found[..., :3], found[..., 3] > 0
    pixels = band.pixels - top * found.shape[1]
    if directed.any():
        kept = borne_out(normals, directed).reshape(-1)[pixels]
        rows[~kept, map_slices()["tangent"]] = 0.0
    if surface:
        surface_widths(rows, spreads(normals).reshape(-1, 3, 3)[pixels])
    return band, rows
