"""The train stage's G-buffers as arrays, with their cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.cameras import Camera
from pipeline.errors import UserError
from pipeline.images import read_image

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


def read_views(folder: Path, cameras: dict[str, Camera]) -> dict[str, DepthView]:
    """Every VIEW with a G-buffer in `folder`. Raises UserError when there is none."""
    out = {}
    for view, camera in sorted(cameras.items()):
        path = folder / f"{view}.exr"
        if not path.exists():
            continue
        a = read_image(path, CHANNELS)
        solid = (a[..., 1] > SOLID) & (a[..., 0] > 0)
        depth = np.where(solid, a[..., 0], 0)
        here = camera if camera.width == a.shape[1] else camera.resized(a.shape[1], a.shape[0])
        out[view] = DepthView(here, depth, a[..., 2:5], a[..., 5:10], a[..., 1])
    if not any((v.depth > 0).any() for v in out.values()):
        raise UserError(folder, "no view shows the object", "look at the train stage's pictures: did it train?")
    return out
