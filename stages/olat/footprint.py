"""Widths of the surface from widths of the pixel: a pixel sees normals that differ, and its lobe is wider by their spread.

A lobe's width matrix (sigma squared) is twice the covariance of the slopes; the slopes of the footprint add theirs (Olano and
Baker 2010, LEAN mapping, read backwards). The spread is the normals' change over one pixel, uniform across it: 1/12.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from stages.olat.columns import columns
from stages.olat.frames import Band
from stages.olat.lobe_fit import ROUND

LEAST = 0.25  # of a pixel's squared width that the surface keeps: the spread is an estimate of its own
EDGE = np.cos(np.radians(45.0))  # neighbours that differ more are another surface
UNIFORM = 1.0 / 12.0  # variance of a uniform distribution over its width squared


def surface_widths(rows: NDArray[np.float64], across: NDArray[np.float64], down: NDArray[np.float64]) -> None:
    """Take the footprint's spread out of sigma, tangent, roughness and anisotropy of `rows` [P, WIDTH], in place.

    across, down [P, 3]: change of the normal over one pixel (`changes`).
    """
    at = columns()
    sigma, tangent, normal = (rows[:, at[name]] for name in ("sigma", "tangent", "specular_normal"))
    one_way = np.linalg.norm(tangent, axis=1) > 0.5
    steps = np.stack([across, down], 1)  # [P, 2, 3]
    both = UNIFORM * np.sum(steps**2, (1, 2))  # mean variance of the two axes, times two
    squares = np.maximum(sigma**2 - both[:, None], LEAST * sigma**2)
    t = tangent[one_way]
    b = np.cross(normal[one_way], t)
    s = np.stack([np.einsum("pkc,pc->pk", steps[one_way], v) for v in (t, b)], 1)  # [P, 2 axes, 2 steps]
    spread = 2 * UNIFORM * s @ s.transpose(0, 2, 1)
    square = sigma[one_way] ** 2
    matrix = np.zeros((len(t), 2, 2))
    matrix[:, 0, 0], matrix[:, 1, 1] = square[:, 0], square[:, 1]
    # whiten by the pixel's widths: there the spread's eigenvalues say how much of the pixel's width it explains
    scale = 1.0 / np.maximum(sigma[one_way], 1e-9)
    value, vector = np.linalg.eigh(spread * scale[:, :, None] * scale[:, None, :])
    kept = np.maximum(1.0 - value, LEAST)
    matrix = np.einsum("pij,pj,pkj->pik", vector, kept, vector) * sigma[one_way][:, :, None] * sigma[one_way][:, None, :]
    value, vector = np.linalg.eigh(matrix)
    squares[one_way] = value[:, ::-1]
    axis = vector[:, :, 1]  # of the larger width
    tangent[one_way] = axis[:, :1] * t + axis[:, 1:] * b
    sigma[:] = np.sqrt(squares)
    large, small = sigma[:, 0], sigma[:, 1]
    tangent[large - small <= ROUND * (large + small)] = 0.0
    rows[:, at["roughness"]] = ((large * small) ** 0.25)[:, None]
    rows[:, at["anisotropy"]] = np.divide(large - small, large + small, out=np.zeros_like(large), where=large > 0)[:, None]


def changes(normals: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Change of the normals [H, W, 3] (0 outside the object) over one pixel, to the right and down, each [H, W, 3].

    Central differences where both neighbours are of the same surface, one-sided where one is, 0 where none is.
    """
    found = []
    for axis in (1, 0):
        inside = np.linalg.norm(normals, axis=-1) > 0.5
        total, count = np.zeros_like(normals), np.zeros(inside.shape)
        ahead = np.roll(normals, -1, axis)
        fine = inside & np.roll(inside, -1, axis) & (np.sum(ahead * normals, -1) > EDGE)
        edge: list[slice | int] = [slice(None), slice(None)]
        edge[axis] = -1  # the last has no next one
        fine[tuple(edge)] = False
        step = np.where(fine[..., None], ahead - normals, 0.0)
        total += step + np.roll(step, 1, axis)  # the last step is 0: nothing wraps around
        count += fine.astype(float) + np.roll(fine, 1, axis)
        found.append(total / np.maximum(count, 1.0)[..., None])
    return found[0], found[1]


def with_neighbours(
    bands: Iterable[tuple[Band, NDArray[np.float64]]], width: int
) -> Iterator[tuple[Band, NDArray[np.float64]]]:
    """The bands (pixels [P] of a frame `width` wide, rows [P, WIDTH]) with the widths of the surface, each one band late.

    Rows of the bands above and below give the edges their neighbours: the result does not depend on the bands' size.
    """
    normal = columns()["normal"]
    above, waiting = np.zeros((1, width, 3)), None
    for band, rows in bands:
        image = np.zeros((band.bottom - band.top, width, 3))
        image.reshape(-1, 3)[band.pixels - band.top * width] = rows[:, normal]
        if waiting is not None:
            yield _finish(*waiting, above, image[:1] if waiting[0].bottom == band.top else np.zeros_like(above))
            above = waiting[2][-1:] if waiting[0].bottom == band.top else np.zeros_like(above)
        waiting = (band, rows, image)
    if waiting is not None:
        yield _finish(*waiting, above, np.zeros_like(above))


def _finish(
    band: Band, rows: NDArray[np.float64], image: NDArray[np.float64], above: NDArray[np.float64], below: NDArray[np.float64]
) -> tuple[Band, NDArray[np.float64]]:
    across, down = changes(np.concatenate([above, image, below]))
    places = band.pixels + (1 - band.top) * image.shape[1]
    surface_widths(rows, across.reshape(-1, 3)[places], down.reshape(-1, 3)[places])
    return band, rows
