"""How much of a constant sky each texel sees: the occlusion texture of renderers that cast no rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.occluder import tangent_frames
from pipeline.geometry.rays import RayMesh
from pipeline.optics.sphere import cosine_directions

from .choice import RAYS

DIRECTIONS = 64
MOST_RAYS = 3_000_000
"""In all: forty thousand points; texels between take their neighbours', for occlusion is smooth but at contacts."""
NEIGHBOURS = 4


def sky_seen(mesh: RayMesh, position: NDArray, normal: NDArray, lift: float) -> NDArray[np.float32]:
    """How much of the hemispheres about points' normals the mesh leaves free, weighted by the cosine.

    Args:
        mesh: what hides the sky.
        position, normal: points and unit normals, world. [T, 3]
        lift: rays start so far above the surface (world units).

    Returns:
        Share of a constant sky's light that arrives, 0..1. [T]
    """
    from scipy.spatial import cKDTree

    step = max(1, -(-len(position) * DIRECTIONS // MOST_RAYS))
    local = cosine_directions(DIRECTIONS)
    chosen = np.arange(0, len(position), step)
    free = np.empty(len(chosen), np.float32)
    rows = max(1, RAYS // DIRECTIONS)
    for start in range(0, len(chosen), rows):
        at = chosen[start : start + rows]
        direction = np.einsum("dk,tkc->tdc", local, tangent_frames(normal[at]))
        origin = position[at] + lift * normal[at]
        free[start : start + rows] = 1 - mesh.blocked(origin[:, None], direction).mean(1)
    if step == 1:
        return free
    distance, near = cKDTree(position[chosen]).query(position, k=NEIGHBOURS)
    weight = 1 / (distance + lift)
    return ((weight * free[near]).sum(1) / weight.sum(1)).astype(np.float32)
