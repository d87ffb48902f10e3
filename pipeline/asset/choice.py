"""Which views see a texel well: facing, footprint, and nothing between (ray casting)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.geometry.rays import RayMesh

from .blend_kernel import keep_best
from .views import PropertyView

BEST = 8
"""Views that a texel is blended from: more blur by what they are misplaced, and add little."""
LEAST_FACING = 0.15  # cosine between view and normal: beyond 81 degrees a pixel spans seven texels
STEEPEST = 1 / LEAST_FACING  # depth that a surface may span across a pixel, in footprints; more is an edge
AT_AN_EDGE = 1e-3  # weight of a pixel beside another surface or none: its colour is mixed
RAYS = 1 << 19  # cast at once


@dataclass(frozen=True)
class Points:
    """Surface points to be seen: position [T, 3] and normal [T, 3], float32; `spacing` between them, in world units."""

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    spacing: float


class Choice:
    """The best views of every point: `view` [T, BEST] (-1: none) and `weight` [T, BEST], found view by view."""

    def __init__(self, points: Points, mesh: RayMesh) -> None:
        self._points, self._mesh = points, mesh
        self.view = np.full((len(points.position), BEST), -1, np.int16)
        self.weight = np.zeros((len(points.position), BEST), np.float32)

    def offer(self, number: int, view: PropertyView) -> None:
        """Let view `number` take the places of worse ones."""
        at, weight = self._seen(view)
        keep_best(at, weight, np.int16(number), self.view, self.weight)

    def _seen(self, view: PropertyView) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The points that a view sees [N], and their weights [N]."""
        camera, p = view.camera, self._points
        towards = camera.centre.astype(np.float32) - p.position
        distance = np.linalg.norm(towards, axis=1)
        facing = np.einsum("tc,tc->t", towards, p.normal) / np.maximum(distance, 1e-30)
        at = np.flatnonzero(facing > LEAST_FACING)
        pixels, z = camera.project(p.position[at].astype(np.float64))
        height, width = view.depth.shape
        inside = (z > 0) & (pixels >= 0).all(1) & (pixels[:, 0] < width) & (pixels[:, 1] < height)
        at, pixels, z = at[inside], pixels[inside].astype(np.int64), z[inside]
        usable = usable_pixels(view)[pixels[:, 1], pixels[:, 0]]
        footprint = z / np.sqrt(camera.fx * camera.fy)
        weight = (usable * (facing[at] ** 2 * p.spacing / footprint) ** 2).astype(np.float32)
        at, weight = at[weight > 0], weight[weight > 0]
        free = ~self._blocked(at, camera)
        return at[free], weight[free]

    def _blocked(self, at: NDArray[np.int64], camera: Camera) -> NDArray[np.bool_]:
        """Whether the mesh lies between points and the camera; rays start a texel above the surface."""
        out = np.zeros(len(at), bool)
        for start in range(0, len(at), RAYS):
            chunk = at[start : start + RAYS]
            origin = self._points.position[chunk] + self._points.normal[chunk] * np.float32(self._points.spacing)
            direction = camera.centre.astype(np.float32) - origin
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            out[start : start + RAYS] = self._mesh.blocked(origin, direction)
        return out


def usable_pixels(view: PropertyView) -> NDArray[np.float32]:
    """The view's weight [H, W], next to nothing at the edges of what it shows."""
    from scipy.ndimage import maximum_filter, minimum_filter

    deepest, nearest = maximum_filter(view.depth, 3), minimum_filter(view.depth, 3)
    footprint = view.depth / np.sqrt(view.camera.fx * view.camera.fy)
    edge = (nearest <= 0) | (deepest - nearest > 2 * STEEPEST * footprint)
    return np.where(edge, AT_AN_EDGE * view.weight, view.weight).astype(np.float32)
