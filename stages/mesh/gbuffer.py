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
KEPT_BYTES = 1 << 30
"""Of views in memory: forty of 1024 x 768; of larger captures the first so many."""


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

    @property
    def bytes(self) -> int:
        """What it takes in memory."""
        return sum(image.nbytes for image in (self.depth, self.normal, self.material, self.alpha))


class Views:
    """Every VIEW with a G-buffer: kept in memory while they are few, else read again whenever they are iterated over."""

    def __init__(self, train: Path, cameras: dict[str, Camera]) -> None:
        """`train`: the train stage's folder. Raises UserError when no view shows the object."""
        paths = [(files.gbuffer(train, view), view, camera) for view, camera in sorted(cameras.items())]
        self._files = [(path, camera) for path, _, camera in paths if path.exists()]
        self.names = [view for path, view, _ in paths if path.exists()]
        self._kept: dict[Path, DepthView] = {}
        self._room = KEPT_BYTES
        if not any((view.depth > 0).any() for view in self):
            raise UserError(
                train / files.GBUFFERS, "no view shows the object", "look at the train stage's pictures: did it train?"
            )

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[DepthView]:
        for path, camera in self._files:
            view = self._kept.get(path)
            if view is None:
                view = read_view(path, camera)
                self._room -= view.bytes
                if self._room > 0:
                    self._kept[path] = view
            yield view


def read_view(path: Path, camera: Camera) -> DepthView:
    """One G-buffer. Raises UserError."""
    surface = read_gbuffer(path)
    solid = (surface.alpha > SOLID) & (surface.depth > 0)
    height, width = solid.shape
    images = (np.where(solid, surface.depth, 0), surface.normal, surface.material, surface.alpha)
    return DepthView(camera.resized(width, height), *(np.ascontiguousarray(image, np.float32) for image in images))
