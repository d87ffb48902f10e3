"""Lens distortion ends in the poses stage: what is resampled to a pinhole camera there, and where later stages look.

Later stages know pinhole cameras only. Where a camera bends straight lines, poses writes the frames again as a pinhole
camera of the same matrix and size would have taken them, and cameras.json holds that camera.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera, distort

FRAMES = "frames.json"
LENSES = "lenses.json"
NOTICEABLE_PX = 0.05
"""A distortion that moves no pixel by more than this is none: pixels are sampled to about this anyway."""


def frames_folder(inputs: Mapping[str, Path]) -> Path:
    """The folder whose frames.json and frames/ fit cameras.json, of a stage's inputs in the order that it needs them.

    The last that has frames: decode's, or those of poses where it resampled them. Where none has (a light stage), the first.
    """
    folders = list(inputs.values())
    return next((folder for folder in reversed(folders) if (folder / FRAMES).is_file()), folders[0])


def frame_table(inputs: Mapping[str, Path]) -> dict[str, dict[str, Any]]:
    """The views of that folder's frames.json; its files are relative to the folder."""
    table: dict[str, dict[str, Any]] = json.loads((frames_folder(inputs) / FRAMES).read_text(encoding="utf-8"))["views"]
    return table


def lenses(inputs: Mapping[str, Path]) -> dict[str, Camera]:
    """The cameras with distortion, by VIEW, whose frames poses resampled; empty where it did not."""
    from pipeline.geometry.cameras import load_cameras

    path = next((folder / LENSES for folder in inputs.values() if (folder / LENSES).is_file()), None)
    return load_cameras(path) if path is not None else {}


def pinhole(camera: Camera) -> Camera:
    """The same camera without its distortion."""
    return replace(camera, distortion=())


def bends(camera: Camera) -> bool:
    """Whether the distortion moves any pixel of the frame noticeably."""
    if not any(camera.distortion):
        return False
    u, v = np.meshgrid(np.linspace(0, camera.width, 17), np.linspace(0, camera.height, 17))
    moved = source_pixels(camera, u, v) - np.stack([u, v], -1)
    return bool(np.abs(moved).max() > NOTICEABLE_PX)


def source_pixels(camera: Camera, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where in the distorted frame the pinhole camera's pixel positions (u, v) lie [..., 2] (pixel centres at +0.5)."""
    ideal = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], -1)
    return distort(ideal, camera.distortion) * [camera.fx, camera.fy] + [camera.cx, camera.cy]


LENS_FACTS = ("width", "height", "fx", "fy", "cx", "cy", "distortion")


@lru_cache(maxsize=4)
def _sampling(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, distortion: tuple[float, ...]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Where each pinhole pixel [H, W] is taken from (x, y; centres at whole numbers), and which lie outside; views share it."""
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    camera = Camera(width, height, fx, fy, cx, cy, np.eye(4), distortion)
    source = (source_pixels(camera, u, v) - 0.5).astype(np.float32)
    x, y = np.ascontiguousarray(source[..., 0]), np.ascontiguousarray(source[..., 1])
    return x, y, ~((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1))


class Straightener:
    """Resamples frames of one camera with distortion; bilinear, so that possible Stokes vectors stay possible.

    A Stokes vector's axes depend on its ray alone (Camera.stokes_frame), so no vector is turned.
    """

    def __init__(self, camera: Camera) -> None:
        self._x, self._y, self.outside = _sampling(*(getattr(camera, name) for name in LENS_FACTS))

    def image(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Samples [H, W, ...] of the pinhole camera; zero where the frame did not reach."""
        import cv2

        flat = image.reshape(*image.shape[:2], -1)
        out = np.empty_like(flat)
        for start in range(0, flat.shape[2], 3):  # remap takes at most four channels
            part = np.ascontiguousarray(flat[..., start : start + 3])
            bent = cv2.remap(part, self._x, self._y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            out[..., start : start + 3] = bent.reshape(*bent.shape[:2], -1)
        out[self.outside] = 0
        return out.reshape(image.shape)

    def mask(self, mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A mask 0..255 [H, W], empty where the frame did not reach."""
        return np.round(self.image(mask.astype(np.float32))).astype(np.uint8)

    def marks(self, marks: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Marked pixels [H, W] (None: none): any that a marked one had a part in, and all that the frame did not reach."""
        if marks is None or not marks.any():
            return self.outside
        return self.outside | (self.image(marks.astype(np.float32)) > 0)
