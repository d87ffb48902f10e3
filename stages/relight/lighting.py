"""One light that a model is put under: a view's pixels and the mesh's points in, their Stokes vectors out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .deferred import Lamp, Surface
from .mesh_images import MeshPixels

if TYPE_CHECKING:
    from pipeline.shading import Occlusion

    from .indirect import Indirect


class Lighting(Protocol):
    """What every light can do."""

    @property
    def occluder(self) -> Indirect | None:
        """What the mesh takes from it and sends on; None where nothing is occluded."""

    def of_view(self, surface: Surface, attachment: Any) -> NDArray[np.float32]:
        """Stokes vectors [P, 3, 3] of a view's points, tied to the mesh (`Indirect.attach`) where it throws shadows."""

    def of_mesh(self, seen: MeshPixels) -> NDArray[np.float32]:
        """Stokes vectors [M, 3, 3] of points of the mesh."""


class MapLighting:
    """An environment map, with the shadows and bounces of the mesh where there are any."""

    def __init__(self, lamp: Lamp, occluder: Indirect | None) -> None:
        self._lamp, self.occluder = lamp, occluder
        self._light = occluder.under(lamp) if occluder else None
        self._received: NDArray | None = None

    def of_view(self, surface: Surface, attachment: Any) -> NDArray[np.float32]:
        """Shadowed, with what the object sends on, reflections too."""
        occlusion = None
        if self.occluder is not None and attachment is not None:
            occlusion = self.occluder.at(attachment, self._light)
        return self._lamp.stokes(surface, occlusion)

    def of_mesh(self, seen: MeshPixels) -> NDArray[np.float32]:
        """Diffuse light shadowed, with what the object sends on; reflections go free."""
        if self.occluder is None:
            return self._lamp.stokes(seen.surface)
        if self._received is None:
            self._received = self.occluder.on_mesh(self._light)
        return self._lamp.stokes(seen.surface, diffuse_occlusion(seen.carried(self._received), 1.0))


def diffuse_occlusion(values: NDArray, unblocked: float) -> Occlusion:
    """Shadow and bounced light [P, 6] as shading takes them, of reflections a share."""
    import torch

    from pipeline.shading import Occlusion

    both: Any = torch.as_tensor(np.ascontiguousarray(values, np.float32))
    free = torch.full((len(values),), unblocked)
    return Occlusion(both[:, :3].contiguous(), both[:, 3:].contiguous(), free, torch.zeros(len(values), 3))
