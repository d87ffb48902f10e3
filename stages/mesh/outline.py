"""How far a mesh's outlines lie inside the images' own: blended discs look larger than the surface through their centres."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.mesh import Mesh
from pipeline.geometry.rays import RayMesh

from .gbuffer import DepthView

ENOUGH_RAYS = 384
"""Rays across an image from which one a pixel measures an area well: over an outline of a thousand pixels the staircase's
error, 0.3 of a pixel each, comes to a hundredth of one. Smaller images get two."""
CELLS = 12
"""Pieces along an image's shorter side in which outlines are compared: a lid that stands out is outvoted."""
BAND = 2.0  # px within a mesh's outline: deeper, an opacity below one is discs that do not quite cover, not a missing rim
SMALLEST_CELL = 8  # px: an outline's staircase averages out over it


def outline_gap(mesh: Mesh, views: Iterable[DepthView]) -> float:
    """Median over pieces of outlines of (area by opacity - area of the mesh) / length, in world units at the object.

    Positive where the mesh is too small. The area by opacity counts partly covered pixels in part, so it is good to a small
    fraction of a pixel; full is what the discs come to inside. Pieces weigh by their length.
    """
    solid = RayMesh(mesh.vertices, mesh.faces)
    found = [piece for view in views if view.depth.any() for piece in _gaps(solid, view)]
    if not found:
        return 0.0
    gaps, lengths = np.concatenate(found, axis=1)
    order = np.argsort(gaps)
    reached = np.cumsum(lengths[order])
    return float(gaps[order][np.searchsorted(reached, 0.5 * reached[-1])])


def _gaps(solid: RayMesh, view: DepthView) -> Iterator[NDArray[np.float64]]:
    """Gaps (world units) and lengths (px) of the pieces [2, N] of a view's outline, if the frame does not cut it off."""
    from scipy.ndimage import binary_erosion, distance_transform_edt

    camera = view.camera
    finer = 1 if min(camera.width, camera.height) >= ENOUGH_RAYS else 2
    fine = camera.resized(camera.width * finer, camera.height * finer)
    covered = solid.blocked(fine.centre, fine.rays())
    if not covered.any() or covered[[0, -1]].any() or covered[:, [0, -1]].any():
        return
    area = covered.reshape(camera.height, finer, camera.width, finer).mean((1, 3))
    edge = (covered & ~binary_erosion(covered)).reshape(camera.height, finer, camera.width, finer).any((1, 3))
    away, (row, column) = distance_transform_edt(~edge, return_indices=True)
    deep = (area == 1) & (away > BAND)
    missing_px = np.minimum(view.alpha / (np.median(view.alpha[deep]) if deep.any() else 1.0), 1) - area
    cell = max(SMALLEST_CELL, min(camera.width, camera.height) // CELLS)
    piece = (row // cell) * (camera.width // cell + 1) + column // cell
    missing = np.bincount(piece.ravel(), np.where(deep, 0, missing_px).ravel())
    lengths = np.bincount(piece.ravel(), _steps(covered).reshape(area.shape[0], finer, -1, finer).sum((1, 3)).ravel()) / finer
    lengths *= np.pi / 4  # of the staircase (Cauchy-Crofton)
    long = lengths > 0.5 * cell
    pixel = float(np.median(view.depth[view.depth > 0])) / np.sqrt(camera.fx * camera.fy)
    yield np.stack([missing[long] / lengths[long] * pixel, lengths[long]])


def _steps(inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Where neighbours differ: each step counts at the pixel before it."""
    out = np.zeros(inside.shape)
    out[:-1] += inside[1:] != inside[:-1]
    out[:, :-1] += inside[:, 1:] != inside[:, :-1]
    return out


def outline_length(inside: np.ndarray) -> float:
    """Length of a mask's boundary in pixels: steps between neighbours, times pi/4 for the staircase (Cauchy-Crofton)."""
    return float(_steps(inside).sum()) * np.pi / 4
