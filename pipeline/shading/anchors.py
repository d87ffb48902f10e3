"""Where GridMap's anchors stand (PhyGaP 4.2, 9.4, and the strategy that 10.4 compares with)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.occluder import Occluder

COUNT = 52
MARGIN = 1.1
"""Bounding box of the anchors against the object's (9.4)."""
CLEARANCE = 0.02
"""How far off the surface its anchors stand, over the object's diagonal: ten times what rays are lifted (`occluder.LIFT`)."""


def box_anchors(vertices: NDArray, up: int = 1) -> NDArray[np.float64]:
    """COUNT points [52, 3]: 4 x 4 on every face of the enlarged bounding box but the 4 inside the bottom face."""
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    centre, half = (low + high) / 2, MARGIN * (high - low) / 2
    grid = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    border = (grid == 0) | (grid == 3)
    bottom = (grid[:, up] == 0) & ~np.delete(border, up, axis=1).any(1)
    return centre + half * (grid[border.any(1) & ~bottom] * (2 / 3) - 1)


def surface_anchors(occluder: Occluder) -> NDArray[np.float64]:
    """COUNT points [52, 3] (fewer on a mesh of fewer vertices) spread over the surface, CLEARANCE along its normals.

    Farthest-point sampling of the vertices, begun at the one farthest from their mean. As the paper says, one that stands off a
    narrow hollow may end up inside the object.
    """
    vertices = occluder.vertices.astype(np.float64)
    chosen = [int(((vertices - vertices.mean(0)) ** 2).sum(-1).argmax())]
    distance = ((vertices - vertices[chosen[0]]) ** 2).sum(-1)
    while len(chosen) < min(COUNT, len(vertices)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, ((vertices - vertices[chosen[-1]]) ** 2).sum(-1))
    clearance = CLEARANCE * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return vertices[chosen] + clearance * occluder.normals[chosen]
