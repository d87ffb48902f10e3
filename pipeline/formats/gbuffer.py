"""G-buffers: what a trained model's views show in each pixel, one EXR of named channels a view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import RGB, read_image, write_exr

Image = NDArray[np.float32]
NORMAL = ("N.X", "N.Y", "N.Z")
ALBEDO = ("albedo.R", "albedo.G", "albedo.B")
MATERIAL = (*ALBEDO, "roughness", "ior")
PARTS = ("diffuse", "specular")
"""Beside the G-buffer of a held-back view stand its Stokes image and, as PART.R .. PART.B, the two parts of its s0."""
CHANNELS = (*NORMAL, *MATERIAL, "alpha", "depth")


@dataclass(frozen=True)
class SurfaceImage:
    """What a view shows of the surface; 0 where there is no object.

    Fields:
        normal: unit, world axes. [H, W, 3]
        material: diffuse albedo R G B (linear, 0..1), perceptual roughness (its square is alpha), IoR. [H, W, 5]
        alpha: opacity, 0..1. [H, W]
        depth: along the camera's z, world units. [H, W]
    """

    normal: Image
    material: Image
    alpha: Image
    depth: Image

    @property
    def albedo(self) -> Image:
        """Diffuse reflectance, linear RGB [H, W, 3]."""
        return self.material[..., :3]

    @property
    def roughness(self) -> Image:
        """Perceptual roughness [H, W]: alpha is its square."""
        return self.material[..., 3]

    @property
    def ior(self) -> Image:
        """Index of refraction [H, W]."""
        return self.material[..., 4]


def read_gbuffer(path: Path) -> SurfaceImage:
    """Read a view's G-buffer.

    Args:
        path: the EXR.

    Returns:
        The view's surface.

    Raises:
        UserError: the file is missing, damaged or lacks one of `CHANNELS`.
    """
    a = read_image(path, CHANNELS)
    return SurfaceImage(a[..., :3], a[..., 3:8], a[..., 8], a[..., 9])


def surface_of(channels: Mapping[str, Image]) -> SurfaceImage:
    """Pick the G-buffer out of an image's channels; a test view of the train stage holds one among others.

    Args:
        channels: by name, all of `CHANNELS` among them. [H, W] each

    Returns:
        The view's surface.
    """
    normal, material = (np.stack([channels[name] for name in names], -1) for names in (NORMAL, MATERIAL))
    return SurfaceImage(normal, material, channels["alpha"], channels["depth"])


def part_of(channels: Mapping[str, Image], part: str) -> Image:
    """Pick one part of the reflected light out of an image's channels.

    Args:
        channels: by name. [H, W] each
        part: one of `PARTS`.

    Returns:
        Linear radiance. [H, W, 3]
    """
    return np.stack([channels[f"{part}.{c}"] for c in RGB], -1)


def channels_of(surface: SurfaceImage) -> dict[str, Image]:
    """Take a G-buffer apart into the channels that a file holds.

    Args:
        surface: the G-buffer.

    Returns:
        Channel of `CHANNELS` to its image, float32; what is not finite becomes 0. [H, W] each
    """
    images = [*np.moveaxis(surface.normal, -1, 0), *np.moveaxis(surface.material, -1, 0), surface.alpha, surface.depth]
    return {name: np.nan_to_num(np.asarray(image, np.float32)) for name, image in zip(CHANNELS, images)}


def write_gbuffer(path: Path, channels: Mapping[str, Image]) -> None:
    """Write the G-buffer among an image's channels as float32 EXR.

    Args:
        path: the file; its folder exists.
        channels: by name, all of `CHANNELS` among them. [H, W] each

    Raises:
        UserError: the file cannot be written.
    """
    write_exr(path, {name: channels[name] for name in CHANNELS})
