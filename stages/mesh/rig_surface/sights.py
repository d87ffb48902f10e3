"""Each camera with its maps and how far away it sees the mesh: what any fusion on the mesh needs of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.mesh import Mesh
from pipeline.geometry.rays import RayMesh
from pipeline.rig.surface.read_maps import Rig, RigMaps

Image = NDArray[np.float32]
KEPT_BYTES = 1 << 29  # of cameras that are kept; others are read and cast anew each time


@dataclass(frozen=True)
class Sight:
    """A camera's maps; surface [H, W]: distance along each ray to the mesh, infinite for a miss; slopes [H, W]: of some maps by
    name, `square_slopes`."""

    maps: RigMaps
    surface: Image
    slopes: dict[str, Image]

    @property
    def nbytes(self) -> int:
        """What it takes of memory."""
        images = (*self.maps.maps.values(), self.surface, *self.slopes.values())
        return sum(image.nbytes for image in images)


class Sights:
    """All cameras of a rig before one mesh, to be gone through several times."""

    def __init__(self, rig: Rig, mesh: Mesh) -> None:
        self._rig, self.solid = rig, RayMesh(mesh.vertices, mesh.faces)
        self._kept: dict[str, Sight] = {}
        self._room = KEPT_BYTES

    def __len__(self) -> int:
        return len(self._rig)

    def __iter__(self) -> Iterator[Sight]:
        for name in self._rig.names:
            sight = self._kept.get(name) or self._made(self._rig.read(name))
            if name not in self._kept and sight.nbytes <= self._room:
                self._kept[name] = sight
                self._room -= sight.nbytes
            yield sight

    def _made(self, maps: RigMaps) -> Sight:
        surface = self.solid.distance(maps.camera.centre, maps.camera.rays())
        known = {"normal": maps.sound, "diffuse_albedo": maps.sound, "specular_albedo": maps.lobed, "sigma": maps.lobed}
        slopes = {name: square_slopes(maps.maps[name], where) for name, where in known.items()}
        slopes["diffuse_albedo"] /= 3.0  # of a colour
        slopes["sigma"] /= 2.0  # of a width
        return Sight(maps, surface, slopes)


def square_slopes(image: Image, known: NDArray[np.bool_]) -> Image:
    """Mean squared difference [H, W] of an image [H, W, C] to the known neighbours, summed over both axes and all channels."""
    total = np.zeros(known.shape, np.float32)
    for axis in (0, 1):
        square, count = np.zeros(known.shape, np.float32), np.zeros(known.shape, np.float32)
        turned, within = np.moveaxis(image, axis, 0), np.moveaxis(known, axis, 0)
        both = within[1:] & within[:-1]
        step = np.where(both, ((turned[1:] - turned[:-1]) ** 2).sum(-1), 0)
        for part in (np.s_[1:], np.s_[:-1]):
            np.moveaxis(square, axis, 0)[part] += step
            np.moveaxis(count, axis, 0)[part] += both
        total += square / np.maximum(count, 1)
    return total
