"""World units of found cameras: from the distance of two cameras, or from a printed marker of known length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import PosesConfig
from pipeline.errors import UserError
from pipeline.geometry.cameras import Camera

MARKER_VIEWS = 2
WORST_MARKER = 0.1
"""Sides of one square marker that differ by more than this share are no measurement."""
Corners = dict[int, NDArray[np.float64]]


def world_scale(told: PosesConfig, cameras: Mapping[str, Camera], pictures: Mapping[str, Path], where: Path) -> float:
    """Factor from COLMAP's units to those of capture.toml's [poses]; 1 where it tells none.

    `cameras` and 8-bit `pictures` by VIEW, `where` is named in errors. Raises UserError.
    """
    if told.scale_pair is not None and told.scale_distance is not None:
        return _by_baseline(told.scale_pair, told.scale_distance, cameras, where)
    if told.marker_length is not None:
        return _by_marker(told, cameras, pictures, where)
    return 1.0


def _by_baseline(pair: Sequence[str], distance: float, cameras: Mapping[str, Camera], where: Path) -> float:
    missing = [view for view in pair if view not in cameras]
    if len(pair) != 2 or missing:
        what = f"has no camera for {missing[0]}" if missing else "is not two views"
        raise UserError(where, f"poses.scale_pair {what}", "name two registered views")
    first, second = (cameras[view].centre for view in pair)
    return float(distance / np.linalg.norm(first - second))


def _by_marker(told: PosesConfig, cameras: Mapping[str, Camera], pictures: Mapping[str, Path], where: Path) -> float:
    assert told.marker_length is not None
    seen: dict[int, list[tuple[Camera, NDArray[np.float64]]]] = {}
    for view, camera in sorted(cameras.items()):
        for number, corners in find_markers(pictures[view], told.marker_dictionary, where).items():
            seen.setdefault(number, []).append((camera, corners))
    sides = [s for found in seen.values() if len(found) >= MARKER_VIEWS for s in marker_sides(found)]
    if not sides:
        have = f"only markers {sorted(seen)}, each in one view" if seen else "no marker"
        raise UserError(
            where,
            f"poses.marker_length: {have} of {told.marker_dictionary} found in {len(cameras)} views",
            "show a flat ArUco marker in two or more views, or name its poses.marker_dictionary",
        )
    length = float(np.median(sides))
    if np.percentile(np.abs(np.array(sides) / length - 1), 75) > WORST_MARKER:
        raise UserError(where, "poses.marker_length: the sides of the markers found differ", "are all of them of this length?")
    return told.marker_length / length


def find_markers(picture: Path, dictionary: str, where: Path) -> Corners:
    """Corners [4, 2] (pixels, centres at +0.5) of the ArUco markers in an 8-bit picture, by their numbers."""
    import cv2

    known = getattr(cv2.aruco, f"DICT_{dictionary.upper()}", None)
    if known is None:
        raise UserError(where, f"poses.marker_dictionary = {dictionary!r} is none of OpenCV's", "such as 4X4_50")
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(known), parameters)
    image = np.asarray(cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE))
    corners, numbers, _ = detector.detectMarkers(image)
    if numbers is None:
        return {}
    return {int(n): c.reshape(4, 2).astype(float) + 0.5 for n, c in zip(np.ravel(numbers), corners)}


def marker_sides(found: Sequence[tuple[Camera, NDArray[np.float64]]]) -> NDArray[np.float64]:
    """The four sides (world units) of one marker whose corners [4, 2] several cameras saw."""
    points = np.stack([_triangulated([(camera, corners[k]) for camera, corners in found]) for k in range(4)])
    return np.asarray(np.linalg.norm(points - np.roll(points, 1, 0), axis=1), np.float64)


def _triangulated(rays: Sequence[tuple[Camera, NDArray[np.float64]]]) -> NDArray[np.float64]:
    """The point [3] nearest to the rays of some pixels."""
    left, right = np.zeros((3, 3)), np.zeros(3)
    for camera, (u, v) in rays:
        ray = camera.rays_at(np.array([u, v])) @ camera.world_to_camera[:3, :3]
        across = np.eye(3) - np.outer(ray, ray)
        left += across
        right += across @ camera.centre
    return np.asarray(np.linalg.solve(left, right), np.float64)
