"""The train stage's G-buffers as arrays, with their cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.images import read_image
from pipeline.geometry.cameras import Camera

Image = NDArray[np.float32]
SOLID = 0.5  # of the opacity: where transmittance falls to one half there is a surface


@dataclass(frozen=True)
class DepthView:
    """One view: depth along the camera's z [H, W] (0: none), world normals [H, W, 3], material [H, W, 5], opacity [H, W].

    Material channels: albedo R G B, roughness, ior.
    """

    camera: Camera
    depth: Image
    normal: Image
    material: Image
    alpha: Image


CHANNELS = ("depth", "alpha", "N.X", "N.Y", "N.Z", "albedo.R", "albedo.G", "albedo.B", "roughness", "ior")


class Views:
    """Every VIEW with a G-buffer, read again whenever it is iterated over: a large capture does not fit into memory."""

    def __init__(self, folder: Path, cameras: dict[str, Camera]) -> None:
        """Raises UserError when no view shows the object."""
        self._files = [(folder / f"{v}.exr", c) for v, c in sorted(cameras.items()) if (folder / f"{v}.exr").exists()]
        if not any((view.depth > 0).any() for view in self):
            raise UserError(folder, "no view shows the object", "look at the train stage's pictures: did it train?")

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[DepthView]:
        for path, camera in self._files:
            yield read_view(path, camera)


def read_view(path: Path, camera: Camera) -> DepthView:
    """One G-buffer. Raises UserError."""
    a = read_image(path, CHANNELS)
    solid = (a[..., 1] > SOLID) & (a[..., 0] > 0)
    depth = np.where(solid, a[..., 0], 0)
    here = camera if camera.width == a.shape[1] else camera.resized(a.shape[1], a.shape[0])
    return DepthView(here, depth, a[..., 2:5], a[..., 5:10], a[..., 1])
