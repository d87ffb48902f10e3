"""Undistortion to pinhole cameras, done once, in the poses stage, and the lookup by which later stages find the frames.

Later stages know pinhole cameras only. Where a camera bends straight lines, poses writes the frames again as a pinhole
camera would have taken them, and cameras.json holds that camera (`pipeline.geometry.straight_camera` says which).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.dataset_files import CAMERAS
from pipeline.formats.images import STOKES
from pipeline.geometry.cameras import Camera, load_cameras
from pipeline.geometry.lens_inverse import inside_fold

FRAMES = "frames.json"
LENSES = "lenses.json"
NOTICEABLE_PX = 0.05
"""A distortion that moves no pixel by more than this is none: pixels are sampled to about this anyway."""


def frames_folder(inputs: Mapping[str, Path]) -> Path:
    """Find the folder whose frames.json and frames/ fit cameras.json: decode's, or that of poses where it resampled the frames.

    Args:
        inputs: a stage's inputs, stage to folder, in the order that it needs them.

    Returns:
        The last folder that has frames; where none has (a light stage), the first.
    """
    folders = list(inputs.values())
    return next((folder for folder in reversed(folders) if (folder / FRAMES).is_file()), folders[0])


def frame_table(inputs: Mapping[str, Path]) -> dict[str, dict[str, Any]]:
    """Read what is known of the frames that fit cameras.json.

    Args:
        inputs: a stage's inputs, stage to folder, in the order that it needs them.

    Returns:
        VIEW to its entry in frames.json; the files it names are relative to `frames_folder(inputs)`.
    """
    table: dict[str, dict[str, Any]] = json.loads((frames_folder(inputs) / FRAMES).read_text(encoding="utf-8"))["views"]
    return table


def lenses(inputs: Mapping[str, Path]) -> dict[str, Straightener]:
    """Make the resampling again that the poses stage applied to frames of lenses that bend lines.

    Args:
        inputs: a stage's inputs, stage to folder.

    Returns:
        VIEW to its straightener; empty where nothing was resampled.
    """
    folder = next((folder for folder in inputs.values() if (folder / LENSES).is_file()), None)
    if folder is None:
        return {}
    straight = load_cameras(folder / CAMERAS)
    return {view: Straightener(camera, straight[view]) for view, camera in load_cameras(folder / LENSES).items()}


def bends(camera: Camera) -> bool:
    """Say whether a lens moves any pixel by more than `NOTICEABLE_PX` from where a pinhole would see it.

    Args:
        camera: any.

    Returns:
        True too where the lens has no ray for a part of the frame.
    """
    if camera.is_pinhole:
        return False
    u, v = np.meshgrid(np.linspace(0, camera.width, 17), np.linspace(0, camera.height, 17))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1)
    moved = np.abs(camera.pixels_of(rays) - np.stack([u, v], -1))
    return not bool((moved <= NOTICEABLE_PX).all())  # NaN: the lens has no such ray


def _facts(camera: Camera) -> tuple[Any, ...]:
    numbers = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return (*numbers, camera.distortion, camera.lens)


def _camera(facts: tuple[Any, ...]) -> Camera:
    width, height, fx, fy, cx, cy, distortion, lens = facts
    return Camera(width, height, fx, fy, cx, cy, np.eye(4), distortion, lens=lens)


Sampling = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.float32] | None]
UNTURNED = tuple(np.eye(3).ravel().tolist())
ROWS = 128  # of a frame whose rays are in memory at once
NOWHERE = -1e4  # pixels; float32 and OpenCV's fixed point hold it


@lru_cache(maxsize=4)
def _sampling(source: tuple[Any, ...], target: tuple[Any, ...], turn: tuple[float, ...]) -> Sampling:
    """Where each pixel [H, W] of the target is taken from (x, y; centres at whole numbers), which lie outside, and the angle
    (rad) of the source's Stokes axes from its own (None: the same); views of one lens share it.

    `turn`: the target's axes in the source's frame, row by row.
    """
    bent, straight = _camera(source), _camera(target)
    axes = np.reshape(turn, (3, 3))
    shape = (straight.height, straight.width)
    x, y, outside = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, bool)
    angle = None if turn == UNTURNED else np.empty(shape, np.float32)
    for start in range(0, straight.height, ROWS):
        rows = slice(start, min(start + ROWS, straight.height))
        v, u = np.mgrid[rows, : straight.width] + 0.5
        rays = np.stack([(u - straight.cx) / straight.fx, (v - straight.cy) / straight.fy, np.ones_like(u)], -1) @ axes
        with np.errstate(invalid="ignore"):
            at = bent.pixels_of(rays) - 0.5
            beyond = ~((at >= 0) & (at <= [bent.width - 1, bent.height - 1])).all(-1)
        # A sphere's picture closes: half a pixel beyond one edge is the other.
        outside[rows] = bent.lens != "EQUIRECTANGULAR" and beyond | ~inside_fold(bent.lens, bent.distortion, rays)
        at = np.nan_to_num(at, nan=NOWHERE).clip(NOWHERE, -NOWHERE + max(bent.width, bent.height))
        x[rows], y[rows] = at[..., 0], at[..., 1]
        if angle is not None:
            angle[rows] = _between(rays, axes)
    return x, y, outside, angle


def _between(rays: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Counter-clockwise angle (rad) [H, W] from the Stokes x axes of a camera with these axes to those of the frame's own."""
    own, theirs = (np.cross(rays, up) for up in (-axes[1], np.array([0.0, -1.0, 0.0])))
    across = np.cross(own, rays)
    across /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.asarray(np.arctan2((theirs * across).sum(-1), (theirs * own).sum(-1)))


class Straightener:
    """Resamples frames of a camera whose lens bends lines to those of a pinhole at the same place.

    Bilinear, so that possible Stokes vectors stay possible. Their axes depend on the ray and the camera's up alone
    (`Camera.stokes_frame`): vectors are turned where the pinhole looks another way, and only there.
    """

    def __init__(self, source: Camera, target: Camera) -> None:
        """Find where each pixel of the pinhole lies in the frame.

        Args:
            source: the camera as it took the frames.
            target: a pinhole at the same place.
        """
        turn = target.world_to_camera[:3, :3] @ source.world_to_camera[:3, :3].T
        same = np.abs(turn - np.eye(3)).max() < 1e-12
        key = UNTURNED if same else tuple(turn.ravel().tolist())
        self._x, self._y, self.outside, self.angle = _sampling(_facts(source), _facts(target), key)
        self.taken = (source.height, source.width)
        """Size of the frames as they were taken (height, width)."""
        self._wraps = source.lens == "EQUIRECTANGULAR"

    def image(self, image: NDArray[np.float32], names: Sequence[str] = ()) -> NDArray[np.float32]:
        """Samples [H, W, ...] of the pinhole camera; zero where the frame did not reach. `names` of the channels, where
        these may be Stokes vectors."""
        import cv2

        flat = image.reshape(*image.shape[:2], -1)
        x = self._x
        if self._wraps:
            flat, x = np.concatenate([flat[:, -1:], flat, flat[:, :1]], 1), x + np.float32(1)
        out = np.empty((*self.outside.shape, flat.shape[2]), np.float32)
        for start in range(0, flat.shape[2], 3):  # remap takes at most four channels
            part = np.ascontiguousarray(flat[..., start : start + 3])
            bent = cv2.remap(part, x, self._y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            out[..., start : start + 3] = bent.reshape(*bent.shape[:2], -1)
        out[self.outside] = 0
        if self.angle is not None and set(STOKES) <= set(names):
            _turn(out, list(names), self.angle)
        return out.reshape(*out.shape[:2], *image.shape[2:])

    def mask(self, mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A mask 0..255 [H, W], empty where the frame did not reach."""
        return np.round(self.image(mask.astype(np.float32))).astype(np.uint8)

    def marks(self, marks: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Marked pixels [H, W] (None: none): any that a marked one had a part in, and all that the frame did not reach."""
        if marks is None or not marks.any():
            return self.outside
        return self.outside | (self.image(marks.astype(np.float32)) > 0)


def _turn(pixels: NDArray[np.float32], names: list[str], angle: NDArray[np.float32]) -> None:
    """Stokes channels [H, W, C] to axes that lie clockwise of theirs by `angle` [H, W] (rad), in place."""
    c, s = np.cos(2 * angle)[..., None], np.sin(2 * angle)[..., None]
    first, second = ([names.index(f"S{k}.{colour}") for colour in "RGB"] for k in (1, 2))
    s1, s2 = pixels[..., first], pixels[..., second]
    pixels[..., first], pixels[..., second] = c * s1 - s * s2, s * s1 + c * s2
