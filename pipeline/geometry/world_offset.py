"""World coordinates too large for the files that hold them: an offset is taken out, and stored in every file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.geometry.viewing_axes import looked_at

STEPS_PER_PIXEL = 64
"""Steps of a float32 coordinate that a pixel's footprint on the object needs: vertices are a pixel or two apart, and normals
between them are then good to a third of a degree."""

LONGEST_HEADER = 1 << 14


def offset_of(cameras: Mapping[str, Camera]) -> NDArray[np.float64]:
    """Choose what to take from all positions so that float32 files keep them.

    Args:
        cameras: by view, in the capture's coordinates.

    Returns:
        World units; zero unless a float32 step at the cameras' and the object's coordinates is more than 1/STEPS_PER_PIXEL of a
        pixel's footprint on the object, else a round place near it. [3]
    """
    if not cameras:
        return np.zeros(3)
    centres = np.stack([c.centre for c in cameras.values()])
    seen = looked_at(cameras.values())
    distance = np.linalg.norm(centres - seen, axis=-1)
    if not np.isfinite(seen).all() or not distance.max() > 0:
        return np.zeros(3)
    footprint = float(np.median(distance / [max(c.fx, c.fy) for c in cameras.values()]))
    largest = np.abs(np.concatenate([centres, seen[None]])).max()
    if np.spacing(np.float32(largest)) * STEPS_PER_PIXEL <= footprint:
        return np.zeros(3)
    step = 10.0 ** np.floor(np.log10(np.median(distance)))
    return np.asarray(np.round(seen / step) * step)


def less(camera: Camera, offset: NDArray[np.float64]) -> Camera:
    """Move a camera into the world whose origin lies at an offset.

    Args:
        camera: any.
        offset: world units. [3]

    Returns:
        The camera with the offset taken from its centre.
    """
    if not offset.any():
        return camera
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = -pose[:3, :3] @ (camera.centre - offset)
    return replace(camera, world_to_camera=pose)


def ply_comment(offset: NDArray[np.float64] | None) -> list[str]:
    """Write an offset as comments of a PLY.

    Args:
        offset: world units; None: zero. [3]

    Returns:
        One line, none where the offset is zero.
    """
    if offset is None or not np.any(offset):
        return []
    return ["offset " + " ".join(repr(float(x)) for x in offset)]


def stored_offset(path: Path) -> NDArray[np.float64]:
    """Read the offset from a PLY's header.

    Args:
        path: the PLY.

    Returns:
        World units; zero where the header has none. [3]
    """
    with path.open("rb") as file:
        head = file.read(LONGEST_HEADER).partition(b"end_header")[0].decode("ascii", "replace")
    stated = [line.split()[2:] for line in head.splitlines() if line.startswith("comment offset ")]
    return np.array([float(x) for x in stated[0]]) if stated else np.zeros(3)
