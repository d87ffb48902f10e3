"""The model under lights that stand in its world: every point sees them where they are, past what the mesh hides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.shading.light_tree_plain import Leaves
from pipeline.shading.sampled_light import received, shade_samples

from .deferred import Lamp, ShadingModel, Surface
from .light_samples import samples
from .lighting import diffuse_occlusion
from .lights_file import Light
from .mesh_images import MeshPixels

if TYPE_CHECKING:
    from .mesh_shadows import SelfOcclusion, Tied

SIDE = 8  # cells along a lamp's side: a half-shadow has 64 steps, below one of 8 bits in most of it
BLOCK = 8192  # points at a time: 64 cells of each make some 200 MB
DARK_CUBE = 16


class PlacedLighting:
    """Lights in the world of the dataset, with the shadows and bounces of the mesh where there are any."""

    def __init__(self, lights: Sequence[Light], model: ShadingModel, occluder: SelfOcclusion | None) -> None:
        self._lights, self._model, self.occluder = lights, model, occluder
        self._dark = Lamp(np.zeros((2 * DARK_CUBE, 4 * DARK_CUBE, 3), np.float32), DARK_CUBE, model)
        if occluder is not None:
            positions, normals = occluder.surface()
            parts = [(positions[rows], normals[rows]) for rows in _blocks(positions)]
            self._light = occluder.lit(torch.cat([received(_single(n), *self._arriving(at, n)) for at, n in parts]))
            self._bounced = occluder.on_mesh(self._light)

    def of_view(self, surface: Surface, attachment: Tied | None) -> NDArray[np.float32]:
        """Shadowed, with one bounce, reflections too."""
        direct = self._direct(surface)
        if self.occluder is None or attachment is None:
            return direct
        return direct + self._dark.stokes(surface, self.occluder.at(attachment, self._light))

    def of_mesh(self, seen: MeshPixels) -> NDArray[np.float32]:
        """Shadowed, with one diffuse bounce."""
        direct = self._direct(seen.surface)
        if self.occluder is None:
            return direct
        return direct + self._dark.stokes(seen.surface, diffuse_occlusion(seen.carried(self._bounced), 1.0))

    def _direct(self, surface: Surface) -> NDArray[np.float32]:
        out = np.zeros((len(surface.position), 3, 3), np.float32)
        for rows in _blocks(surface.position):
            part = surface.part(rows)
            leaves, radiance = self._arriving(part.position, part.normal)
            normal, view, material, x, y = map(_single, (part.normal, part.view, part.material, part.frame_x, part.frame_y))
            stokes = shade_samples(
                normal, view, material[:, :3], material[:, 3], material[:, 4], x, y, leaves, radiance, self._model.lobe
            )
            out[rows] = stokes.numpy()
        return out

    def _arriving(self, position: NDArray, normal: NDArray) -> tuple[Leaves, torch.Tensor]:
        """What reaches points [P, 3] with unit normals [P, 3], as leaves, and the lamps' radiances [N, 3]."""
        starts = self.occluder.starts(position, normal) if self.occluder else None
        found: list[tuple[NDArray, ...]] = []
        for k, light in enumerate(self._lights):
            seen = samples(light, position, SIDE)
            above = (np.einsum("pkc,pc->pk", seen.direction, normal) > 0) & (seen.solid_angle > 0)
            point, cell = np.nonzero(above)
            direction, distance = seen.direction[point, cell], seen.distance[point, cell]
            if self.occluder is not None and starts is not None:
                free = ~self.occluder.hidden(starts[point], direction, distance)
                point, cell, direction = point[free], cell[free], direction[free]
            found.append((point, np.full(len(point), k), direction, seen.solid_angle[point, cell]))
        point, node, direction, angle = (np.concatenate(parts) for parts in zip(*found))
        size = _single(angle)
        variance = size / 12  # a square's
        leaves = Leaves(torch.as_tensor(point), torch.as_tensor(node), _single(direction), size, variance)
        return leaves, torch.stack([_single(samples(light, position[:1], 1).radiance) for light in self._lights])


def _blocks(points: NDArray) -> list[slice]:
    return [slice(start, start + BLOCK) for start in range(0, max(len(points), 1), BLOCK)]


def _single(values: NDArray) -> torch.Tensor:
    return torch.as_tensor(np.ascontiguousarray(values, np.float32))
