"""Silhouettes of a start surface, for pictures that have no masks."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pipeline.geometry.cameras import Camera
from pipeline.geometry.rays import RayMesh

from .hull import HullMesh

MARGIN = 2  # pixels on either side of the outline that are left undecided: a surface through points is that uncertain
WHOLE = 0.999  # share of all pixels from which masks are no masks


def are_masks(masks: list[np.ndarray]) -> bool:
    """Whether the masks leave anything out: all-white ones only say that there are none."""
    return sum(float((m > 0.5).sum()) for m in masks) < WHOLE * sum(m.size for m in masks)


def outline(mesh: HullMesh, camera: Camera) -> np.ndarray:
    """Mask float32 [H, W] of the mesh (in the camera's world): 1 on it, 0 off it, 0.5 where its outline may be."""
    middle = 0.5 * (mesh.vertices.max(0) + mesh.vertices.min(0))
    size = float(np.ptp(mesh.vertices, axis=0).max())  # open3d casts rays in float32
    solid = RayMesh((mesh.vertices - middle) / size, mesh.triangles)
    hit = np.isfinite(solid.distance((camera.centre - middle) / size, camera.rays()))
    near = ndimage.binary_dilation(hit, iterations=MARGIN)
    core = ndimage.binary_erosion(hit, iterations=MARGIN, border_value=1)
    return (0.5 * near + 0.5 * core).astype(np.float32)
