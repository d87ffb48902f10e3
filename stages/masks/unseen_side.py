"""Which side of an object no camera faces: nothing bounds its shape there, and nothing shows its material."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.geometry.world import Y_UP_FROM
from stages.masks.background import fixation
from stages.masks.doubts import FEWEST_AROUND

SQUAREST = 0.1
"""Cosine of the angle to the normal below which a view says nothing of a surface (84 degrees): as meshes are textured."""
SIDE_DEG = 45.0
"""From the middle of a side to where the next begins, of six that all directions fall into, as on a cube."""

ROUNDING = 1e-6
"""Of unit directions: a residual below it is none."""


@dataclass(frozen=True)
class UnseenSide:
    """Surface whose normal is within `reach_deg` of `towards` (unit, world [3]) is seen by no view; `nearest` of all views is
    `away_deg` from that direction."""

    towards: NDArray[np.float64]
    away_deg: float
    reach_deg: float
    nearest: str

    def as_json(self) -> dict[str, Any]:
        """The form among the stage's facts."""
        towards = [round(float(x), 4) for x in self.towards]
        return {"towards": towards, "away_deg": round(self.away_deg, 1), "reach_deg": round(self.reach_deg, 1)}

    def said(self, up: str) -> str:
        """In words, of a world with this axis up."""
        x, y, z = self.towards + 0.0
        height = float((Y_UP_FROM[up] @ self.towards)[1])
        side = {1: "the upper side", -1: "the underside", 0: "one side"}[int(np.sign(height)) * (abs(height) > np.sqrt(0.5))]
        return (
            f"{side} of the object is seen by no view: the nearest, {self.nearest}, is {self.away_deg:.0f} degrees from its "
            f"direction ({x:.2f} {y:.2f} {z:.2f}), so what faces within {self.reach_deg:.0f} degrees of that is a guess"
        )


def unseen_side(cameras: Mapping[str, Camera]) -> UnseenSide | None:
    """Find the side that is left unseen, by view directions alone, as of a convex object that is small beside its distance.

    Args:
        cameras: by view.

    Returns:
        The middle of what no camera faces; None where that is less than a side, where the cameras do not look at one thing, and
        where they are too few to promise anything.
    """
    names = sorted(cameras)
    listed = [cameras[name] for name in names]
    ball = fixation(listed) if len(listed) >= FEWEST_AROUND else None
    if ball is None:
        return None
    directions = np.stack([camera.centre - ball.centre for camera in listed])
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    towards = furthest_from(directions)
    if towards is None:
        return None
    cosines = directions @ towards
    away = float(np.degrees(np.arccos(np.clip(cosines.max(), -1, 1))))
    reach = away - float(np.degrees(np.arccos(SQUAREST)))
    return UnseenSide(towards, away, reach, names[int(cosines.argmax())]) if reach > SIDE_DEG else None


def furthest_from(directions: NDArray) -> NDArray[np.float64] | None:
    """Find the direction whose nearest one is as far away as can be, if that is more than 90 degrees.

    The least vector x with x . d <= -1 for every direction d: least distance programming, solved as non-negative least squares
    (Lawson and Hanson 1974, Solving Least Squares Problems, ch. 23).

    Args:
        directions: unit. [N, 3]

    Returns:
        A unit vector [3]; None where the directions lie in no open half-space.
    """
    from scipy.optimize import nnls

    system = np.concatenate([-directions.T, np.ones((1, len(directions)))])
    wanted = np.array([0.0, 0.0, 0.0, 1.0])
    solution, residual = nnls(system, wanted)
    across = (system @ solution)[:3]
    length = float(np.linalg.norm(across))
    return across / length if residual > ROUNDING and length > 0 else None
