"""Camera positions around the object and their OpenGL camera-to-world matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GOLDEN_ANGLE = np.pi * (3 - 5**0.5)


def orbit(count: int, distance: float, low_deg: float, high_deg: float) -> NDArray[np.float64]:
    """Spread camera positions around the origin: azimuth by the golden angle, elevation evenly in its sine.

    Args:
        count: how many.
        distance: from the origin.
        low_deg, high_deg: range of the elevation.

    Returns:
        Positions. [count, 3]
    """
    low, high = np.sin(np.radians([low_deg, high_deg]))
    sine = low + (high - low) * ((np.arange(count) * 7) % count + 0.5) / count
    azimuth = np.arange(count) * GOLDEN_ANGLE
    cosine = np.sqrt(1 - sine**2)
    return distance * np.stack([cosine * np.cos(azimuth), sine, cosine * np.sin(azimuth)], -1)


def look_at(position: NDArray, target: NDArray | None = None) -> NDArray[np.float64]:
    """Compute the pose of a camera that looks at a place, y up.

    Args:
        position: of the camera. [3]
        target: that it looks at; None: the origin. [3]

    Returns:
        OpenGL camera-to-world (looking along -z). [4, 4]
    """
    back = position - (0 if target is None else target)
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, position], -1)
    return matrix


def fibonacci_sphere(count: int) -> NDArray[np.float64]:
    """Spread directions nearly evenly over the sphere.

    Args:
        count: how many.

    Returns:
        Unit directions, from +y to -y. [count, 3]
    """
    y = 1 - (2 * np.arange(count) + 1) / count
    azimuth = np.arange(count) * GOLDEN_ANGLE
    radius = np.sqrt(1 - y**2)
    return np.stack([radius * np.cos(azimuth), y, radius * np.sin(azimuth)], -1)
