"""Single cameras that do not fit what all others agree on, and whether a turn would make them fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pipeline.geometry.camera_slips import AS_GOOD, HOPELESS, turned
from pipeline.geometry.cameras import Camera

STANDS_OUT = 5.0
"""Times the typical camera's error from which one is not like the others."""
LEAST_TURN_DEG = 0.5
"""Of one camera: less is what poses differ by."""
LEAST_GAIN = 4.0
"""Factor by which a turn must make a camera's errors smaller: three numbers explain some of whatever is there."""
AROUND = np.array([(pitch, yaw, 0.0) for pitch in (0, -0.15, 0.15, -0.3, 0.3) for yaw in (0, -0.15, 0.15, -0.3, 0.3)])
ROLLED = np.array([(0.0, 0.0, roll) for roll in (np.pi, np.pi / 2, -np.pi / 2)])
"""Rotation vectors that a turn is looked for around; pictures are stored upside down or on their side too."""
FEW = 0.25
"""Share of the cameras up to which they are at fault one by one."""


class Evidence(Protocol):
    """What pairs of views say of cameras."""

    def __call__(self, cameras: Sequence[Camera], view: int | None = None) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Pairs of views [E, 2] and errors [E] (pixels, 0 or more) of all equations, or of those that hold `view`."""


def odd_cameras(
    cameras: Sequence[Camera], evidence: Evidence, kept: float, good_px: float, odd_px: float, fewest: int
) -> dict[int, str]:
    """Find cameras that fit the others only when they are turned.

    Args:
        cameras: pinholes.
        evidence: of pairs of them.
        kept: share of a camera's equations that are true at least.
        good_px: error up to which a camera fits in any case.
        odd_px: error up to which it is not looked at.
        fewest: equations of one camera that say something.

    Returns:
        By number, by how much it is off, in words; empty where that is none or many of them.
    """
    pairs, errors = evidence(cameras)
    enough = np.bincount(pairs.ravel(), minlength=len(cameras)) >= fewest
    judged = enough[pairs].all(1)  # what cannot be judged, and may be at fault, must not be blamed on others
    shares = [errors[judged & (pairs == k).any(1)] for k in range(len(cameras))]
    each = np.array([_better_part(own, kept) if own.size >= fewest / 2 else 0.0 for own in shares])
    typical = float(np.median(each))
    limit = max(odd_px, STANDS_OUT * typical)
    odd = np.nonzero(enough & (each > limit))[0]
    odd = odd[[not _blamed(int(k), odd, pairs[judged], errors[judged], kept, fewest / 2, limit) for k in odd]]
    most = max(1, int(FEW * len(cameras)))
    said: dict[int, str] = {}
    for k in sorted(odd[np.argsort(-each[odd], kind="stable")][:most]):
        degrees, left = _best_turn(int(k), np.union1d(odd, np.nonzero(~enough)[0]), cameras, evidence, kept)
        if degrees > LEAST_TURN_DEG and left <= min(max(good_px, 2 * typical), each[k] / LEAST_GAIN):
            said[int(k)] = f"{each[k]:.1f} px off; turned by {degrees:.1f} degrees it would fit"
    return said if len(odd) <= len(cameras) / 2 else {}


def _blamed(
    view: int, odd: NDArray[np.intp], pairs: NDArray[np.intp], errors: NDArray[np.float64], kept: float, fewest: float,
    limit: float,
) -> bool:  # fmt: skip
    """Whether a camera fits all those that are not odd: then another's fault made it look so."""
    own = errors[(pairs == view).any(1) & ~np.isin(pairs, odd[odd != view]).any(1)]
    return own.size >= fewest and _better_part(own, kept) <= limit


def _better_part(errors: NDArray[np.float64], kept: float) -> float:
    return float(np.sort(errors)[: max(1, int(kept * errors.size))].mean())


def _best_turn(
    view: int, odd: NDArray[np.intp], cameras: Sequence[Camera], evidence: Evidence, kept: float
) -> tuple[float, float]:
    """The turn (degrees) of one camera that fits the others best, and its error then (pixels)."""
    camera, others = cameras[view], odd[odd != view]
    size = evidence(cameras, view)[1].size

    def error(vector: NDArray[np.float64]) -> float:
        tried = [turned(camera, vector) if k == view else c for k, c in enumerate(cameras)]
        pairs, errors = evidence(tried, view)
        errors = errors[~np.isin(pairs, others).any(1)]
        return min(_better_part(errors, kept), HOPELESS) if errors.size > kept * size / 2 else HOPELESS

    step = 0.1 * max(camera.width, camera.height) / camera.fx
    found = []
    for starts in (AROUND, ROLLED):
        start = min(starts, key=error) + np.concatenate([np.zeros((1, 3)), step * np.eye(3)])
        options = {"initial_simplex": start, "maxfev": 300, "xatol": 1e-5}
        fine = minimize(error, start[0], method="Nelder-Mead", options=options)
        found.append((float(np.degrees(np.linalg.norm(fine.x))), float(fine.fun)))
    return found[1] if found[1][1] * AS_GOOD < found[0][1] else found[0]
