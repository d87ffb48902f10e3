"""Can this be a camera? One answer for every reader of cameras, which names its own file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from pipeline.errors import UserError

ROTATION_TOLERANCE = 0.01
"""Of R Rᵀ - 1: files that round to three digits pass, a scale of one percent does not."""
SHORTEST_FOCAL = 0.05
"""Of the longer side: a pinhole would see 169 degrees; it is a focal length in other units, such as millimetres or widths."""
SQUEEZED = 2.5
"""Ratio of the two focal lengths: anamorphic lenses squeeze by 2."""
CORNER, FAR_CORNER = 1.0, 0.01
"""Pixels from the first corner in both directions, where a principal point is missing or in parts of the image; and part of the
size from the last, where it is of an image twice as large."""
FURTHEST_CENTRE = 10.0
"""Image sizes: crops keep their lens's principal point, but not so far away."""
FURTHEST_PLACE = 1e12
"""World units from the origin: float64 still tells a ten-thousandth of a unit apart there, and no survey lies beyond."""
SAME_PLACE = 1e-9
"""Of the coordinates: camera centres that differ by less than this are one."""


class CameraLike(Protocol):
    """What is checked of a `cameras.Camera`."""

    @property
    def name(self) -> str: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...
    @property
    def distortion(self) -> tuple[float, ...]: ...
    @property
    def world_to_camera(self) -> np.ndarray: ...
    @property
    def centre(self) -> np.ndarray: ...


AnyCamera = TypeVar("AnyCamera", bound=CameraLike)


def check_camera(camera: AnyCamera, path: str | Path, what: str) -> AnyCamera:
    """Check that a camera can be one: size, focal lengths, principal point, a rigid and finite pose.

    Args:
        camera: as read.
        path: its file, for errors.
        what: the frame or image that it is of, for errors.

    Returns:
        The camera itself.

    Raises:
        UserError: it can be no camera; says why.
    """
    fault, remedy = _fault(camera)
    if fault:
        raise UserError(path, f"{what}: {fault}", remedy)
    return camera


def _fault(camera: CameraLike) -> tuple[str, str]:
    """What is wrong, and what to do; empty where nothing is."""
    pose = np.asarray(camera.world_to_camera, float)
    if pose.shape == (4, 4) and np.isfinite(pose).all() and np.abs(camera.centre).max() > FURTHEST_PLACE:
        return f"its place, {_listed(camera.centre)}, is no place", "check the matrix, or give positions in other units"
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.isfinite(camera.centre).all():
        return "the pose is not finite", "remove the view, or export its camera again"
    if not np.isfinite(numbers).all() or not np.isfinite(camera.distortion).all():
        return f"focal lengths and principal point {_listed(numbers)} are not finite", "export the camera again"
    if camera.width <= 0 or camera.height <= 0:
        return f"the size is {camera.width}x{camera.height}: it must be above 0", "give the size of the image in pixels"
    if camera.fx <= 0 or camera.fy <= 0:
        return f"the focal lengths {_listed(numbers[:2])} must be above 0", "give them in pixels"
    longest = max(camera.width, camera.height)
    if min(camera.fx, camera.fy) < SHORTEST_FOCAL * longest:
        return f"the focal lengths {_listed(numbers[:2])} are not pixels of a {camera.width}x{camera.height} image", (
            "give them in pixels"
        )
    if max(camera.fx, camera.fy) > SQUEEZED * min(camera.fx, camera.fy):
        return f"the focal lengths {_listed(numbers[:2])} are of no lens", "give fx, fy, cx and cy in their order, in pixels"
    if max(abs(camera.cx - camera.width / 2), abs(camera.cy - camera.height / 2)) > FURTHEST_CENTRE * longest:
        return f"the principal point {_listed(numbers[2:])} is far off the {camera.width}x{camera.height} image", (
            "give it in pixels from the image's top left corner"
        )
    first = min(camera.cx, camera.cy) >= 0 and max(camera.cx, camera.cy) <= CORNER < min(camera.width, camera.height) / 2
    last = max(abs(camera.cx / camera.width - 1), abs(camera.cy / camera.height - 1)) < FAR_CORNER
    if first or last:
        return f"the principal point {_listed(numbers[2:])} is a corner of the {camera.width}x{camera.height} image", (
            "give it in pixels of this image from its top left corner, usually half of the size"
        )
    turn = pose[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(turn) < 0:
        return "the 3x3 part of its matrix is no rotation", "take scale and mirroring out of it"
    if not np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6):
        return "the last row of its matrix is not 0 0 0 1", "write matrices row by row"
    return "", ""


def _listed(numbers: Iterable[float]) -> str:
    return ", ".join(f"{x:g}" for x in numbers)


def one_pose_words(cameras: Mapping[str, CameraLike], path: str | Path) -> list[str]:
    """A warning where views of one physical camera stand at the same place and look the same way.

    Args:
        cameras: by view.
        path: their file.

    Returns:
        The line, or nothing.
    """
    seen: dict[tuple[str, bytes], str] = {}
    pairs = []
    for view, camera in sorted(cameras.items()):
        first = seen.setdefault((camera.name, np.asarray(camera.world_to_camera, float).tobytes()), view)
        if first != view:
            pairs.append(f"{first} and {view}")
    if not pairs:
        return []
    more = f" and {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
    return [f"{path}: {pairs[0]}{more} have one pose, to the last digit: check that each view has its own"]


def outside_words(cameras: Mapping[str, CameraLike], path: str | Path) -> list[str]:
    """A warning where most principal points lie outside of their pictures, as those of larger pictures do.

    Args:
        cameras: by view.
        path: their file.

    Returns:
        The line, or nothing.
    """
    outside = [c for c in cameras.values() if not (0 <= c.cx <= c.width and 0 <= c.cy <= c.height)]
    if len(outside) <= len(cameras) / 2:
        return []
    first = outside[0]
    point = f"principal points lie outside of the pictures ({_listed((first.cx, first.cy))} of {first.width}x{first.height})"
    return [f"{path}: {point}: check that focal lengths and principal points are of pictures of this size"]


FEWEST_TO_JUDGE = 8
"""Views, that is what training needs: fewer are looked at, not made a model of, and may well come from one tripod."""


def refuse_one_place(cameras: Mapping[str, CameraLike], path: str | Path) -> None:
    """Refuse cameras that all stand at one place, from where no shape can be known; fewer than `FEWEST_TO_JUDGE` pass.

    Args:
        cameras: by view.
        path: their file, for errors.

    Raises:
        UserError: all stand within `SAME_PLACE` of each other.
    """
    if len(cameras) < FEWEST_TO_JUDGE:
        return
    centres = np.stack([camera.centre for camera in cameras.values()])
    if np.ptp(centres, axis=0).max() <= SAME_PLACE * max(1.0, float(np.abs(centres).max())):
        remedy = (
            "give each view its own pose (are these matrices from world to camera, where camera to world is meant?), or remove "
            "them to have them found"
        )
        raise UserError(path, f"all {len(cameras)} cameras stand at one place", remedy)
