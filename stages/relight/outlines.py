"""Pixels of a view that show more than one surface: silhouettes from the mesh, and no bright rims within the object.

A G-buffer blends the normals and materials of all that a pixel shows, and light does not follow the blend: where a front
meets what lies behind it, or the sky, the blended normal may mirror a lamp that neither surface sees. On the silhouette the
mesh is seen by several rays a pixel, each at a place with its own normal, material and shadows, and their light is averaged.
Within the object the mesh may close gaps that the G-buffer shows; there a blend is no brighter than what it lies between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera

from .mesh_images import BakedMesh, MeshPixels

OPAQUE = 0.98  # opacity from which a pixel shows the object alone
STEADY = 0.7  # cosine between neighbours' normals (45 degrees): beyond, a pixel lies on two surfaces or on an edge
SIDE = 3  # rays a side of such a pixel
PAIRS = ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1]))  # of neighbours, down and across


def silhouette(alpha: NDArray, whole: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels [H, W] at the object's edge, of opacity alpha [H, W]; `whole` [H, W]: wholly inside the mask."""
    return (alpha < OPAQUE) & ~whole


def blended(normal: NDArray) -> NDArray[np.bool_]:
    """Pixels [H, W] with a neighbour whose normal [H, W, 3] (unit, 0 where nothing is) differs much."""
    turned = np.zeros(normal.shape[:2], bool)
    there = np.linalg.norm(normal, axis=-1) > 0.5
    for first, second in PAIRS:
        apart = ((normal[first] * normal[second]).sum(-1) < STEADY) & there[first] & there[second]
        turned[first] |= apart
        turned[second] |= apart
    return turned


def without_bright_rims(stokes: NDArray[np.float32], rim: NDArray[np.bool_], shown: NDArray[np.bool_]) -> NDArray[np.float32]:
    """A Stokes image [H, W, 3, 3] whose `rim` pixels [H, W] are no brighter than the brightest of the eight around them that
    are `shown` and no rim themselves, channel by channel; where there are none they stay."""
    from scipy.ndimage import maximum_filter

    steady = np.where((shown & ~rim)[..., None], stokes[:, :, 0], -1.0)
    bound = maximum_filter(steady, (3, 3, 1), mode="constant", cval=-1.0)
    over = rim[..., None] & (bound >= 0) & (stokes[:, :, 0] > bound)
    factor = np.where(over, bound / np.where(over, stokes[:, :, 0], 1), 1)
    return stokes * factor[:, :, None].astype(np.float32)


def interior(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels [H, W] of a mask whose four neighbours are in it too: wholly covered, as far as a mask can tell."""
    inner = np.pad(mask, 1)
    return mask & inner[:-2, 1:-1] & inner[2:, 1:-1] & inner[1:-1, :-2] & inner[1:-1, 2:]


@dataclass(frozen=True)
class Outlines:
    """A view's silhouette: `rows` [U] of its shaded pixels, and what the rays of each meet on the mesh."""

    rows: NDArray[np.int64]
    seen: MeshPixels

    @property
    def coverage(self) -> NDArray[np.float32]:
        """Share of each pixel's rays that meet the mesh [U]."""
        return self.seen.hit.reshape(len(self.rows), SIDE * SIDE).mean(1, dtype=np.float32)

    def replaced(self, stokes: NDArray[np.float32], of_mesh: NDArray[np.float32]) -> NDArray[np.float32]:
        """A view's Stokes vectors [P, 3, 3] with the mean of what the rays meet [M, 3, 3] where they meet anything."""
        fine = np.zeros((len(self.seen.hit), 3, 3), np.float32)
        fine[self.seen.hit] = np.nan_to_num(of_mesh)
        covered = self.coverage
        met = covered > 0
        out = stokes.copy()
        means = fine.reshape(len(self.rows), SIDE * SIDE, 3, 3).mean(1)
        out[self.rows[met]] = means[met] / covered[met, None, None]
        return out


def find_outlines(mesh: BakedMesh, camera: Camera, index: NDArray[np.int64], wanted: NDArray[np.bool_]) -> Outlines:
    """Those `wanted` [H, W] of the shaded pixels with flat indices `index` [P]."""
    rows = np.flatnonzero(wanted.ravel()[index])
    return Outlines(rows, mesh.seen_at(camera, index[rows], SIDE))
