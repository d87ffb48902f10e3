"""World coordinates too large for the files that hold them: an offset is taken out, stored, and told in every file."""

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
    """What to take from all positions [3] so that float32 files keep them: zero unless a float32 step at the cameras' and the
    object's coordinates is more than 1/STEPS_PER_PIXEL of a pixel's footprint on the object."""
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
    """The camera in the world whose origin lies at `offset`."""
    if not offset.any():
        return camera
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = -pose[:3, :3] @ (camera.centre - offset)
    return replace(camera, world_to_camera=pose)


def ply_comment(offset: NDArray[np.float64] | None) -> list[str]:
    """The comment of a PLY that tells the offset; none where it is zero."""
    if offset is None or not np.any(offset):
        return []
    return ["offset " + " ".join(repr(float(x)) for x in offset)]


def offset_told(path: Path) -> NDArray[np.float64]:
    """The offset [3] that a PLY's header tells; zero where it tells none."""
    with path.open("rb") as file:
        head = file.read(LONGEST_HEADER).partition(b"end_header")[0].decode("ascii", "replace")
    told = [line.split()[2:] for line in head.splitlines() if line.startswith("comment offset ")]
    return np.array([float(x) for x in told[0]]) if told else np.zeros(3)
