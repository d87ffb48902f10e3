"""What the textures are made from: pictures of the surface's properties with their cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera

Image = NDArray[np.float32]


@dataclass(frozen=True)
class PropertyView:
    """One view of a surface, 0 where it shows none.

    values [H, W, C]: what is blended (world normals first: X Y Z; then the material's channels). weight [H, W] >= 0: how far
    each pixel counts. depth [H, W]: along the camera's z, world units. detail [H, W, 3] and detail_weight [H, W], where there
    are photographs: log of what multiplies the albedo at a scale that `values` do not resolve.
    """

    camera: Camera
    values: Image
    weight: Image
    depth: Image
    detail: Image | None = None
    detail_weight: Image | None = None


class PropertyViews(Protocol):
    """Views that can be gone through several times: not all of them need fit into memory."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[PropertyView]: ...
