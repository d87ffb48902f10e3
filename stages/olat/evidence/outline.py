"""Which way is out at the object's outline, in the world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.geometry.cameras import Camera

RING = 2.5  # pixels from the outline within which a normal counts as one of it
SMOOTH = 1.5  # pixels


def outward(mask: NDArray[np.bool_], camera: Camera, pixels: NDArray[np.intp]) -> NDArray[np.float64]:
    """Unit vectors [P, 3] out of the object at flat indices `pixels`; 0 away from the outline and at the frame's edge."""
    inside = np.pad(mask, 1, mode="edge")  # what the frame cuts has no outline there
    distance = ndimage.distance_transform_edt(inside)
    slope = np.stack(np.gradient(ndimage.gaussian_filter(distance, SMOOTH)), -1)[1:-1, 1:-1].reshape(-1, 2)[pixels]
    near = distance[1:-1, 1:-1].reshape(-1)[pixels] <= RING
    down, right = -slope[:, 0], -slope[:, 1]
    size = np.hypot(down, right)
    told = near & (size > 0.2)
    right, down = (np.where(told, v / np.maximum(size, 1e-9), 0.0) for v in (right, down))
    axes = camera.world_to_camera[:3, :3]  # rows: right, down, forward
    return right[:, None] * axes[0] + down[:, None] * axes[1]
