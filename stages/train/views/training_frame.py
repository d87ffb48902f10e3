"""The normalised training frame: object at the origin, radius about 1, y up, unit exposure; and the way back."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from pipeline.geometry.cameras import Camera
from pipeline.geometry.world import Y_UP_FROM


@dataclass(frozen=True)
class SceneFrame:
    """x_train = rotation (x_world - centre) / scale; radiance_train = exposure * radiance.

    rotation [3, 3] is a signed permutation (the up axis), centre in world units, scale in world units per training unit.
    """

    rotation: tuple[tuple[float, ...], ...]
    centre: tuple[float, ...]
    scale: float
    exposure: float = 1.0

    @classmethod
    def of(cls, up: str, centre: np.ndarray, scale: float) -> SceneFrame:
        """The frame of an object of half-size `scale` about `centre`, for a capture with this up axis."""
        return cls(tuple(tuple(map(float, row)) for row in Y_UP_FROM[up]), tuple(map(float, centre)), float(scale))

    @property
    def train_from_world(self) -> np.ndarray:
        """Rotation float64 [3, 3]."""
        return np.asarray(self.rotation)

    def camera(self, camera: Camera) -> Camera:
        """A camera in the training frame: depths come out in training units."""
        rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
        out = np.eye(4)
        out[:3, :3] = rotation @ self.train_from_world.T
        out[:3, 3] = (rotation @ np.asarray(self.centre) + translation) / self.scale
        return replace(camera, world_to_camera=out)

    def points_to_world(self, points: np.ndarray) -> np.ndarray:
        """World positions [..., 3] of training-frame positions."""
        return points @ self.train_from_world * self.scale + np.asarray(self.centre)

    def directions_to_world(self, directions: np.ndarray) -> np.ndarray:
        """World directions [..., 3] of training-frame directions."""
        return directions @ self.train_from_world

    def as_json(self) -> dict[str, Any]:
        """JSON-able form."""
        return asdict(self)
