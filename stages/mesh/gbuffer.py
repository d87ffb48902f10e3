"""The train stage's G-buffers as arrays, with their cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import read_gbuffer
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


class Views:
    """Every VIEW with a G-buffer, read again whenever it is iterated over: a large capture does not fit into memory."""

    def __init__(self, train: Path, cameras: dict[str, Camera]) -> None:
        """`train`: the train stage's folder. Raises UserError when no view shows the object."""
        paths = [(files.gbuffer(train, view), camera) for view, camera in sorted(cameras.items())]
        self._files = [(path, camera) for path, camera in paths if path.exists()]
        if not any((view.depth > 0).any() for view in self):
            raise UserError(
                train / files.GBUFFERS, "no view shows the object", "look at the train stage's pictures: did it train?"
            )

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[DepthView]:
        for path, camera in self._files:
            yield read_view(path, camera)


def read_view(path: Path, camera: Camera) -> DepthView:
    """One G-buffer. Raises UserError."""
    surface = read_gbuffer(path)
    solid = (surface.alpha > SOLID) & (surface.depth > 0)
    height, width = solid.shape
    depth = np.where(solid, surface.depth, 0)
    return DepthView(camera.resized(width, height), depth, surface.normal, surface.material, surface.alpha)
