"""Which pinhole camera the frames of a lens are resampled to: one that keeps the object, at a sane size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.geometry.lens_inverse import fold, pixels_per_radian
from pipeline.geometry.lens_models import MODELS, PERSPECTIVE_REACH, PINHOLE

WIDEST = np.radians(60)
"""Off a pinhole's axis: there a pixel covers a quarter of the solid angle that it covers in the middle."""
LARGEST = 2.0
"""Of the frame's longer side: what the straight picture may grow to before the camera is turned to the object instead."""
MARGIN = 1.1
"""Of the object's extent: backgrounds tell the segmentation and the edges something."""
OBJECT_POINTS = 4096
UNREACHED = 0.05
"""Share of the frame's edge that a folding lens may leave out: fits are poor in the corners. More, and it is not this lens."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Straight:
    """The pinhole camera that a view is resampled to.

    Fields:
        camera: the pinhole.
        whole: whether it is known to hold all of the object.
    """

    camera: Camera
    whole: bool = True


def is_wide(camera: Camera) -> bool:
    """Say whether a lens is a fisheye or a sphere, so that a pinhole of the same matrix and size means little.

    Args:
        camera: any.

    Returns:
        True where the lens model reaches past what a perspective image can.
    """
    return MODELS[camera.lens].reach > PERSPECTIVE_REACH


def pinhole(camera: Camera) -> Camera:
    """Take the lens off a camera.

    Args:
        camera: any.

    Returns:
        A pinhole of the same matrix, size and pose.
    """
    return replace(camera, distortion=(), lens=PINHOLE)


def unreached(camera: Camera) -> float:
    """Compute the share of a frame's edge where the lens model has folded, so that no ray comes there.

    Args:
        camera: any.

    Returns:
        0..1, from 256 places along the edge.
    """
    if camera.lens == "EQUIRECTANGULAR":
        return 0.0
    known = fold(camera.lens, camera.distortion)
    centre = np.array([camera.cx, camera.cy])
    w, h = camera.width, camera.height
    steps = np.linspace(0, 1, 64, endpoint=False)
    edge = np.concatenate([[(w * t, 0) for t in steps], [(w, h * t) for t in steps],
                           [(w - w * t, h) for t in steps], [(0, h - h * t) for t in steps]])  # fmt: skip
    flat = (edge - centre) / [camera.fx, camera.fy]
    if not (known.angles < MODELS[camera.lens].reach - 1e-9).any():
        return 0.0
    # The azimuth of the ray and that of its image point differ by the tangential terms alone.
    return float((np.linalg.norm(flat, axis=-1) > known.radius_at(np.arctan2(flat[:, 1], flat[:, 0]))).mean())


def object_rays(camera: Camera, mask: NDArray[np.bool_]) -> Array:
    """Find the rays over an object's mask, its extreme pixels among them.

    Args:
        camera: with its lens.
        mask: True inside; of any size with the picture's aspect. [H, W]

    Returns:
        Rays in the camera's frame, at most about `OBJECT_POINTS`; pixels that no ray reaches are left out. [N, 3]
    """
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return np.zeros((0, 3))
    extreme = [k for values in (rows, columns) for k in (values.argmin(), values.argmax())]
    some = np.unique(np.concatenate([np.arange(0, len(rows), max(1, len(rows) // OBJECT_POINTS)), extreme]))
    scale = np.array([camera.width / mask.shape[1], camera.height / mask.shape[0]])
    rays = camera.rays_at((np.stack([columns[some], rows[some]], -1) + 0.5) * scale)
    return rays[np.isfinite(rays).all(-1)]


def straight_cameras(cameras: Mapping[str, Camera], objects: Mapping[str, Array]) -> dict[str, Straight]:
    """Choose the pinhole that each view is resampled to.

    A bent pinhole keeps its matrix and size. A wider lens keeps its scale in the middle; the frame grows where the object
    (or, where it is not known, the picture up to WIDEST) asks for it, alike for all views of one lens; where that would
    grow too far, or the object lies past what a pinhole can show, the camera of that view is turned to the object.

    Args:
        cameras: by view.
        objects: rays of each view's object in its camera's frame, where known. [N, 3] each

    Returns:
        The choice, by view.
    """
    out: dict[str, Straight] = {}
    groups: dict[tuple[object, ...], list[str]] = {}
    for view, camera in cameras.items():
        if not is_wide(camera):
            out[view] = Straight(pinhole(camera))
        else:
            numbers = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
            groups.setdefault((camera.lens, camera.distortion, *numbers), []).append(view)
    for views in groups.values():
        known = {v: objects[v] for v in views if v in objects and len(objects[v])}
        ahead = _ahead(cameras[views[0]], known)
        for view in views:
            camera = cameras[view]
            if ahead is not None:
                out[view] = Straight(replace(ahead, world_to_camera=camera.world_to_camera, name=camera.name))
            elif view in known:
                out[view] = _turned(camera, known[view])
            else:  # nothing is known of this view's object: the middle of the picture
                out[view] = Straight(_widest(camera), whole=False)
    return out


def _ahead(camera: Camera, known: Mapping[str, Array]) -> Camera | None:
    """The pinhole that looks along the lens's own axis and holds all objects; None where there is none of a sane size."""
    if camera.lens == "EQUIRECTANGULAR":
        return None
    if not known:
        return _widest(camera)
    rays = np.concatenate(list(known.values()))
    if (rays[:, 2] < np.cos(WIDEST)).any():
        return None
    return _holding(camera, MARGIN * np.abs(rays[:, :2] / rays[:, 2:]).max(0))


def _widest(camera: Camera) -> Camera:
    """The pinhole along the axis that holds the picture, up to WIDEST and the largest size."""
    edge = np.array([[0, camera.cy], [camera.width, camera.cy], [camera.cx, 0], [camera.cx, camera.height]], float)
    rays = camera.rays_at(edge)
    limit = np.tan(WIDEST)
    angle = np.where(np.isfinite(rays).all(-1), np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]), WIDEST)
    reach = np.tan(np.minimum(angle, WIDEST))
    wanted = np.minimum([reach[:2].max(), reach[2:].max()], limit)
    scale = _scale(camera)
    most = LARGEST * max(camera.width, camera.height) / 2
    held = _holding(camera, np.minimum(wanted, [most / (camera.fx * scale), most / (camera.fy * scale)]))
    assert held is not None
    return held


def _scale(camera: Camera) -> float:
    """The lens's scale in the middle, of its focal lengths."""
    return pixels_per_radian(camera.lens, camera.distortion, (1.0, 1.0), np.array([0.0, 0.0, 1.0]))


def _holding(camera: Camera, half: Array) -> Camera | None:
    """The pinhole of the lens's middle whose frame reaches tangents `half` (x, y) off the axis, at least the lens's frame."""
    scale = _scale(camera)
    fx, fy = camera.fx * scale, camera.fy * scale
    size = [max(n, int(2 * np.ceil(f * h + abs(c - n / 2)))) for n, f, h, c in
            zip((camera.width, camera.height), (fx, fy), half, (camera.cx, camera.cy))]  # fmt: skip
    if max(size) > LARGEST * max(camera.width, camera.height) + 2:
        return None
    cx, cy = camera.cx + (size[0] - camera.width) / 2, camera.cy + (size[1] - camera.height) / 2
    return Camera(size[0], size[1], fx, fy, cx, cy, camera.world_to_camera, name=camera.name)


def _turned(camera: Camera, rays: Array) -> Straight:
    """A pinhole at the camera's place that looks at the object, upright as the camera is."""
    middle = rays.mean(0)
    length = float(np.linalg.norm(middle))
    forward = middle / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])
    up = np.array([0.0, -1.0, 0.0]) if abs(forward[1]) < 0.99 else np.array([0.0, 0.0, 1.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])  # target from source
    local = rays @ turn.T
    seen = local[:, 2] > np.cos(WIDEST)
    half = MARGIN * np.abs(local[seen, :2] / local[seen, 2:]).max(0) if seen.any() else np.full(2, np.tan(WIDEST))
    focal = pixels_per_radian(camera.lens, camera.distortion, (camera.fx, camera.fy), forward)
    most = LARGEST * max(camera.width, camera.height)
    sides = np.ceil(2 * focal * np.minimum(half, np.tan(WIDEST)))
    size = [int(min(max(s, 8), most)) for s in sides]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn @ camera.world_to_camera[:3, :3], turn @ camera.world_to_camera[:3, 3]
    straight = Camera(size[0], size[1], focal, focal, size[0] / 2, size[1] / 2, pose, name=camera.name)
    return Straight(straight, bool(seen.all()) and float(sides.max()) <= most)
