"""Mistakes that leave every camera possible by itself, undone: wrong focal lengths, a mirrored world, another order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pipeline.geometry.cameras import Camera

FACTORS = 2.0 ** np.arange(-3, 3.5, 0.5)
"""Of focal lengths that are tried: a fit at one of the ends is none (the far one stands for no perspective at all)."""
LEAST_FACTOR = 1.1
"""Of a focal length: below it is what calibrations differ by."""
LEAST_SHIFT = 0.02
"""Of the longer side, for a principal point: the same."""
AS_GOOD = 1.5
"""Factor of two misfits that noise makes."""
HOPELESS = 1e9
"""Pixels: any misfit from here on is as bad; finite, so that a search can take differences of it."""
MIRRORS = {"x": (-1.0, 1.0, 1.0), "y": (1.0, -1.0, 1.0), "z": (1.0, 1.0, -1.0)}
LIKE_MIRRORS = {"x": "mirrored left to right", "y": "mirrored top to bottom", "z": "turned upside down"}
"""Of pictures, what cannot be told from a world that is mirrored in the same axis (in z it lies behind its cameras)."""
QUARTERS = {"clockwise": 1, "counter-clockwise": -1}
Misfit = Callable[[Sequence[Camera]], float]
"""How badly some cameras fit the pictures: lower is better."""


@dataclass(frozen=True)
class Slip:
    """Cameras without one mistake, and the mistake with its remedy in words."""

    cameras: list[Camera]
    said: str


def with_focal(cameras: Sequence[Camera], factor: float) -> list[Camera]:
    """Multiply focal lengths by a factor."""
    return [replace(c, fx=c.fx * factor, fy=c.fy * factor) for c in cameras]


def with_centre(cameras: Sequence[Camera], right: float, down: float) -> list[Camera]:
    """Move principal points by parts of each picture's longer side."""
    return [replace(c, cx=c.cx + right * _side(c), cy=c.cy + down * _side(c)) for c in cameras]


def mirrored(cameras: Sequence[Camera], signs: Sequence[float]) -> list[Camera]:
    """Mirror the world, and each camera's own axes with it, so that rotations stay rotations.

    Args:
        cameras: any.
        signs: of x, y, z.

    Returns:
        Cameras that would see a mirrored object in these pictures.
    """
    flip = np.diag([*signs, 1.0])
    return [replace(c, world_to_camera=flip @ c.world_to_camera @ flip) for c in cameras]


def turned(camera: Camera, vector: NDArray[np.float64]) -> Camera:
    """Turn a camera about its own centre by a rotation vector (radians, its own axes) [3]."""
    from scipy.spatial.transform import Rotation

    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(vector).as_matrix()
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def _side(camera: Camera) -> int:
    return max(camera.width, camera.height)


def likeliest(cameras: Sequence[Camera], misfit: Misfit) -> tuple[str, float]:
    """Find the mistake that explains best why cameras do not fit.

    Args:
        cameras: as given, in the order of their views.
        misfit: tells how badly cameras fit, 0 or more.

    Returns:
        The simplest of those that come within `AS_GOOD` of the best, in words with its remedy, and the misfit without it.
    """
    found = [(slip.said, misfit(slip.cameras)) for slip in slips(cameras, misfit)]
    least = min(left for _, left in found)
    return next((said, left) for said, left in found if left <= AS_GOOD * least)


def slips(cameras: Sequence[Camera], misfit: Misfit) -> Iterator[Slip]:
    """Undo one mistake after the other, each as well as it can be.

    Args:
        cameras: as given, in the order of their views.
        misfit: tells how badly cameras fit.

    Yields:
        Simple mistakes before those with more to choose.
    """
    focal = best_focal(cameras, misfit)
    if focal is not None and abs(np.log(focal)) > np.log(LEAST_FACTOR):
        yield Slip(
            with_focal(cameras, focal),
            f"all focal lengths times {focal:.2f} fit: check them, and the picture size that they are of",
        )
    for axis, signs in MIRRORS.items():
        yield Slip(
            mirrored(cameras, signs),
            f"a world mirrored in {axis} fits, or pictures {LIKE_MIRRORS[axis]}: check the handedness of the axes that the "
            "poses were written in, and how the pictures were saved",
        )
    for way, quarters in QUARTERS.items():
        rolled = [turned(camera, np.array([0.0, 0.0, quarters * np.pi / 2])) for camera in cameras]
        yield Slip(rolled, f"pictures turned by 90 degrees {way} fit: give them in the orientation that the cameras are of")
    for said, order in orders(len(cameras)):
        moved = [posed(camera, cameras[k]) for camera, k in zip(cameras, order)]
        yield Slip(moved, f"poses {said} fit: check which pose belongs to which picture")
    yield from _shifts(cameras, misfit)


def orders(count: int) -> Iterator[tuple[str, list[int]]]:
    """Orders that lists of files are mixed up into: each picture's pose is the one of this number.

    Args:
        count: of views.

    Yields:
        What it is, and the order.
    """
    natural = sorted(range(count), key=str)  # 0, 1, 10, 11, 2: as text
    back = [natural.index(k) for k in range(count)]
    yield "in the opposite order", list(range(count))[::-1]
    for step in (1, -1):
        yield f"of the {'next' if step > 0 else 'previous'} picture", [(k + step) % count for k in range(count)]
    if natural != list(range(count)):
        yield "in the order of numbers sorted as text (1, 10, 11, 2)", natural
        yield "in the order of numbers (1, 2, 10, 11)", back


def posed(camera: Camera, other: Camera) -> Camera:
    """Give a camera another's pose.

    Args:
        camera: whose lens and picture stay.
        other: whose pose it takes.

    Returns:
        The camera where the other stands.
    """
    return replace(camera, world_to_camera=other.world_to_camera)


def best_focal(cameras: Sequence[Camera], misfit: Misfit) -> float | None:
    """Find the factor of all focal lengths that fits best; None where that is at an end of what is tried."""
    values = [misfit(with_focal(cameras, f)) for f in FACTORS]
    k = int(np.argmin(values))
    if k in (0, len(FACTORS) - 1):
        return None
    start = np.log(FACTORS[[k, k + 1]])[:, None]
    fine = minimize(lambda p: min(misfit(with_focal(cameras, float(np.exp(p[0])))), HOPELESS), start[0], method="Nelder-Mead",
                    options={"initial_simplex": start, "xatol": 2e-3, "fatol": 0, "maxfev": 40})  # fmt: skip
    return float(np.exp(fine.x[0]))


def _shifts(cameras: Sequence[Camera], misfit: Misfit) -> Iterator[Slip]:
    """Principal points and focal lengths together."""

    def error(p: NDArray[np.float64]) -> float:
        if abs(p[0]) > np.log(FACTORS[-1]) or max(abs(p[1:])) > 0.5:
            return HOPELESS
        return min(misfit(with_centre(with_focal(cameras, float(np.exp(p[0]))), p[1], p[2])), HOPELESS)

    start = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    fine = minimize(error, start[0], method="Nelder-Mead",
                    options={"initial_simplex": start, "xatol": 1e-3, "fatol": 0, "maxfev": 150})  # fmt: skip
    log_factor, right, down = fine.x
    if max(abs(right), abs(down)) > LEAST_SHIFT:
        first = cameras[0]
        x, y = first.cx + right * _side(first), first.cy + down * _side(first)
        focal = "" if abs(log_factor) < np.log(LEAST_FACTOR) else f" and focal lengths times {np.exp(log_factor):.2f}"
        yield Slip(
            with_centre(with_focal(cameras, float(np.exp(log_factor))), right, down),
            f"principal points at {x:.0f}, {y:.0f} of {first.width}x{first.height}{focal} fit: check cx and cy, and whether "
            "the pictures were cut or scaled after calibration",
        )
