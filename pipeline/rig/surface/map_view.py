"""What one light-stage camera's maps say of its pixels, and lookups between pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.geometry.cameras import Camera

Float = NDArray[np.float64]


@dataclass(frozen=True)
class MapView:
    """A camera with its maps: coverage by the object [H, W]; normal [H, W, 3] (unit, world, 0 where none is known) and
    albedo [H, W, 3]."""

    name: str
    camera: Camera
    mask: Float
    normal: Float
    albedo: Float

    @property
    def known(self) -> NDArray[np.bool_]:
        """Pixels with a normal [H, W]."""
        return np.asarray(self.normal.any(-1))

    def project(self, points: Float) -> tuple[Float, Float]:
        """Columns and rows [N, 2] of world points [N, 3], centres at whole numbers, and their distances [N] (NaN behind)."""
        camera = self.camera
        local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        if camera.is_pinhole:
            with np.errstate(divide="ignore", invalid="ignore"):
                pixels = local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        else:
            pixels = camera.pixels_of(local)
        return np.where(local[:, 2:] > 0, pixels - 0.5, np.nan), np.linalg.norm(local, axis=1)


def sampled(image: Float, pixels: Float) -> Float:
    """Sample an image bilinearly.

    Args:
        image: any number of channels. [H, W, ...]
        pixels: columns and rows, centres at whole numbers; beyond the edge (or NaN) they take the edge's. [N, 2]

    Returns:
        Samples. [N, ...]
    """
    height, width = image.shape[:2]
    x = np.clip(np.nan_to_num(pixels[:, 0]), 0, width - 1.001)
    y = np.clip(np.nan_to_num(pixels[:, 1]), 0, height - 1.001)
    i, j = x.astype(np.int64), y.astype(np.int64)
    extra = (slice(None), *(None,) * (image.ndim - 2))
    u, v = (x - i)[extra], (y - j)[extra]
    flat = image.reshape(-1, *image.shape[2:])
    at = j * width + i
    top = flat[at] * (1 - u) + flat[at + 1] * u
    at += width
    return top * (1 - v) + (flat[at] * (1 - u) + flat[at + 1] * u) * v


def inside_frame(pixels: Float, width: int, height: int) -> NDArray[np.bool_]:
    """Tell which places lie between pixel centres of a frame.

    Args:
        pixels: columns and rows, centres at whole numbers. [N, 2]
        width, height: of the frame.

    Returns:
        Whether each does. [N]
    """
    with np.errstate(invalid="ignore"):
        return (pixels >= 0).all(-1) & (pixels[:, 0] <= width - 1) & (pixels[:, 1] <= height - 1)


def reduced(view: MapView, factor: int) -> MapView:
    """The view at 1 / `factor` of its size: normals and albedos of what is known, averaged."""
    if factor <= 1:
        return view
    height, width = (-(-n // factor) for n in view.mask.shape)

    def mean(image: Float) -> Float:
        pad = [(0, height * factor - image.shape[0]), (0, width * factor - image.shape[1])] + [(0, 0)] * (image.ndim - 2)
        blocks = np.pad(image, pad).reshape(height, factor, width, factor, *image.shape[2:])
        return blocks.mean((1, 3))

    share = mean(view.known.astype(float))[..., None]
    normal, albedo = mean(view.normal), mean(view.albedo) / np.maximum(share, 1e-9)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    sound = (share > 0.5) & (length > 0.25)
    normal = np.where(sound, normal / np.maximum(length, 1e-9), 0.0)
    whole = view.camera.resized(view.camera.width, view.camera.height)
    camera = whole.resized(width, height)
    scale = 1.0 / factor  # not by the sizes: the last block may stick out
    camera = Camera(
        width, height, whole.fx * scale, whole.fy * scale, whole.cx * scale, whole.cy * scale, whole.world_to_camera,
        whole.distortion, whole.name, whole.lens,
    )  # fmt: skip
    return MapView(view.name, camera, mean(view.mask), normal, albedo * sound)


def smoothed_normals(view: MapView, sigma: float) -> Float:
    """The normals [H, W, 3] blurred among themselves by `sigma` pixels: what a wide comparison should see."""
    known = view.known.astype(float)
    blurred = np.stack([ndimage.gaussian_filter(view.normal[..., k] * known, sigma) for k in range(3)], -1)
    length = np.linalg.norm(blurred, axis=-1, keepdims=True)
    return np.where(view.known[..., None] & (length > 1e-6), blurred / np.maximum(length, 1e-9), 0.0)
