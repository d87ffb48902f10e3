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

    Fields:
        camera: of the view.
        values: what is blended: world normals X Y Z first, then the material's channels. [H, W, C]
        weight: >= 0, how far each pixel counts. [H, W]
        depth: along the camera's z, world units. [H, W]
        detail: log of what multiplies the albedo at a scale that `values` do not resolve; None: no photograph. [H, W, 3]
        detail_weight: >= 0, how far each pixel's detail counts. [H, W]
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
