"""How many triangles a light stage's surface will have, before it is made."""

from __future__ import annotations

from pipeline.capture import Capture
from pipeline.rig.surface.fineness import FINER, MOST_TRIANGLES
from stages.object_share import object_share

A_VOXEL = 3.7
"""Triangles for each square voxel of four times the object's outline: 3.4 to 4.1 were measured on four objects."""


def likely_triangles(capture: Capture, voxel_px: float, max_voxels: int) -> float:
    """Estimate the triangles of a light stage's mesh before it is made.

    Args:
        capture: a light stage.
        voxel_px: the mesh stage's.
        max_voxels: the mesh stage's, along the object's longest side: that many squared lie on each of some six sides at most.

    Returns:
        Their number, halfway between both where it is open whether they are cut into four.
    """
    pixels = sum(capture.pixels) / max(1, len(capture.pixels)) * object_share(capture)  # of the object in a view
    first = A_VOXEL * min(4 * pixels / (FINER * voxel_px) ** 2, 2 * max_voxels**2)
    if 4 * first < 0.8 * MOST_TRIANGLES:
        return 4 * first
    return first if 4 * first > 1.2 * MOST_TRIANGLES else 2 * first
