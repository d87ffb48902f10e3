"""Visual hull of silhouettes: how deep in it a point lies, and a cube that holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pipeline.errors import UserError
from pipeline.geometry.axes import nearest_to_lines
from pipeline.geometry.cameras import Camera

MIN_VIEW_FRACTION = 0.5  # points outside the frame of more than this share of the views are treated as empty


@dataclass(frozen=True)
class Silhouette:
    """One view's mask with its camera.

    Fields:
        camera: a pinhole of the mask's size.
        mask: coverage by the object, 0..1. [H, W]
    """

    camera: Camera
    mask: np.ndarray


def signed_distance(mask: np.ndarray, offset: float = 0.0, blur: float = 0.7) -> np.ndarray:
    """Compute the signed distance of pixels to a mask's contour.

    Args:
        mask: coverage 0..1; where it lies between, the contour is found to a fraction of a pixel. [H, W]
        offset: pixels by which the mask is grown.
        blur: sigma of a Gaussian that takes the stair steps out, pixels.

    Returns:
        Distance in pixels, positive inside, float32; 1000 or -1000 all over for a full or an empty mask. [H, W]
    """
    inside = mask > 0.5
    if not inside.any() or inside.all():
        return np.full(mask.shape, 1e3 if inside.all() else -1e3, np.float32)
    far = ndimage.distance_transform_edt(inside) - 0.5
    near = ndimage.distance_transform_edt(~inside) - 0.5
    distance = np.where(inside, far, -near)
    soft = (mask > 0.02) & (mask < 0.98)
    distance = np.where(soft, mask - 0.5, distance)
    return (ndimage.gaussian_filter(distance, blur) + offset).astype(np.float32)


def bounds(silhouettes: Sequence[Silhouette]) -> tuple[np.ndarray, float]:
    """Find a cube that holds the object: about the point where the rays through the masks' centroids meet best.

    Args:
        silhouettes: views; those with an empty mask are passed over.

    Returns:
        Centre [3] and half the side, world units.

    Raises:
        UserError: every mask is empty, all views look along one line, or they look away from each other.
    """
    centres, directions, spreads = [], [], []
    for s in silhouettes:
        ys, xs = np.nonzero(s.mask > 0.5)
        if not len(xs):
            continue
        pixel = np.array([xs.mean() + 0.5, ys.mean() + 0.5])
        c = s.camera
        local = np.array([(pixel[0] - c.cx) / c.fx, (pixel[1] - c.cy) / c.fy, 1.0])
        direction = c.world_to_camera[:3, :3].T @ local
        centres.append(c.centre)
        directions.append(direction / np.linalg.norm(direction))
        across, down = (max(float(np.abs(v).max()), 0.5) for v in (xs + 0.5 - pixel[0], ys + 0.5 - pixel[1]))
        spreads.append(np.hypot(across / c.fx, down / c.fy))
    if not centres:
        raise UserError("masks", "every mask is empty", "check the masks")
    o, d = np.array(centres), np.array(directions)
    centre = nearest_to_lines(o, d)
    if centre is None:
        raise UserError("cameras", "every view looks along the same line", "photograph the object from around it")
    depths = np.einsum("vk,vk->v", centre - o, d)
    if np.median(depths) <= 0:
        raise UserError("cameras", "the views look away from each other's object", "check the camera convention")
    return centre, float(np.median(np.array(spreads) * depths))


def occupancy(
    silhouettes: Sequence[Silhouette], distances: Sequence[np.ndarray], points: np.ndarray, outvoted: int = 0
) -> np.ndarray:
    """Compute the signed distance of points to the visual hull.

    A point outside a picture is not judged by it; one that less than `MIN_VIEW_FRACTION` of the pictures judge is outside.

    Args:
        silhouettes: views.
        distances: `signed_distance` of each view's mask, pixels. [H, W] each
        points: world positions. [M, 3]
        outvoted: so many of the most negative views are overruled at each point, which forgives as many bad masks.

    Returns:
        Distance in world units, positive inside, float32. [M]
    """
    worst = np.full((outvoted + 1, len(points)), np.inf, np.float32)
    judges = np.zeros(len(points), np.int32)
    if not outvoted:
        _judge_all(silhouettes, distances, points, worst[0], judges)
        return _judged(worst[0], judges, len(silhouettes))
    for s, distance in zip(silhouettes, distances):
        pixels, z = s.camera.project(points)
        height, width = distance.shape
        with np.errstate(invalid="ignore"):
            seen = (z > 0) & (pixels >= 0).all(-1) & (pixels[:, 0] <= width) & (pixels[:, 1] <= height)
        at = pixels[seen]
        value = ndimage.map_coordinates(distance, [at[:, 1] - 0.5, at[:, 0] - 0.5], order=1, mode="nearest")
        length = np.full(len(points), np.inf, np.float32)
        judges += seen
        length[seen] = value * (z[seen] / (0.5 * (s.camera.fx + s.camera.fy))).astype(np.float32)
        worst = np.sort(np.concatenate([worst, length[None]]), 0)[: outvoted + 1]
    return _judged(worst[-1], judges, len(silhouettes), worst)


def _judge_all(
    silhouettes: Sequence[Silhouette],
    distances: Sequence[np.ndarray],
    points: np.ndarray,
    worst: np.ndarray,
    judges: np.ndarray,
) -> None:
    """Least signed distance [M] (it comes as infinity) and number of judges [M], a picture at a time, in one pass each."""
    from .silhouette_kernel import judge

    places = np.ascontiguousarray(points, np.float64)
    for s, distance in zip(silhouettes, distances):
        lens = np.array([s.camera.fx, s.camera.fy, s.camera.cx, s.camera.cy])
        matrix = np.ascontiguousarray(s.camera.world_to_camera, np.float64)
        judge(places, matrix, lens, np.ascontiguousarray(distance, np.float64), worst, judges)


def _judged(worst: np.ndarray, judges: np.ndarray, pictures: int, all_: np.ndarray | None = None) -> np.ndarray:
    """Distances [M] where enough of the pictures judge; elsewhere as far outside as anything is."""
    finite = worst if all_ is None else all_
    finite = finite[np.isfinite(finite)]
    far = max(float(np.abs(finite).max()) if len(finite) else 1.0, 1e-30)
    judged = judges >= max(2, MIN_VIEW_FRACTION * pictures)
    return np.where(judged & np.isfinite(worst), worst, -far).astype(np.float32)


def grid(low: np.ndarray, high: np.ndarray, spacing: float) -> tuple[np.ndarray, tuple[int, ...]]:
    """Lay a grid of points over a box.

    Args:
        low, high: corners of the box. [3]
        spacing: between neighbours, in the same unit.

    Returns:
        Points from `low` to `high` or just beyond, x slowest [M, 3], and how many lie along x, y, z.
    """
    axes = grid_axes(low, high, spacing)
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3), tuple(map(len, axes))


def grid_axes(low: np.ndarray, high: np.ndarray, spacing: float) -> list[np.ndarray]:
    """Lay out the coordinates of `grid` along x, y and z.

    Args:
        low, high: corners of the box. [3]
        spacing: between neighbours, in the same unit.

    Returns:
        From `low` to `high` or just beyond, by axis. 3 of [N]
    """
    # Counted, not stepped to an end: far from the origin the end would be met or missed by rounding.
    return [a + spacing * np.arange(int(np.ceil(round((b - a) / spacing, 6))) + 1) for a, b in zip(low, high)]
