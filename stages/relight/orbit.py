"""Cameras of a turntable: once around the object, at the capture's elevation, as near as all of it fits the frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.geometry.world import Y_UP_FROM

MARGIN = 0.06  # of the frame's half width left free beside the widest frame


def orbit(cameras: Mapping[str, Camera], vertices: NDArray, up: str, count: int, size: int) -> list[Camera]:
    """`count` square cameras of `size` pixels around the middle of the vertices [V, 3].

    They have the capture's widest field of view and median elevation; their distance is the least from which every vertex
    falls inside every frame, MARGIN from its edge.
    """
    turn = Y_UP_FROM[up]
    centre = (vertices.min(0) + vertices.max(0)) / 2
    offsets = np.stack([(c.centre - centre) @ turn.T for c in cameras.values()])
    distances = np.maximum(np.linalg.norm(offsets, axis=1), np.finfo(float).tiny)
    elevation = float(np.median(np.arcsin(np.clip(offsets[:, 1] / distances, -1, 1))))
    focal = min(c.fy / c.height for c in cameras.values()) * size
    rotations = [_rotation(2 * np.pi * k / count, elevation) @ turn for k in range(count)]
    half = (1 - MARGIN) * size / (2 * focal)
    distance = max(_least_distance((vertices - centre) @ r.T, half) for r in rotations)
    out = []
    for rotation in rotations:
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = -rotation @ (centre - distance * rotation[2])
        out.append(Camera(size, size, focal, focal, size / 2, size / 2, pose))
    return out


def _rotation(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Camera (OpenCV) from y-up world, looking at the middle."""
    back = np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])
    right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    return np.stack([right, -np.cross(back, right), -back])


def _least_distance(local: NDArray, half: float) -> float:
    """From where points [V, 3] in the camera's axes lie within the tangent `half` of its axis: |x| <= half (z + distance)."""
    return float((np.abs(local[:, :2]).max(1) / half - local[:, 2]).max())
