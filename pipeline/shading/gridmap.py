"""PhyGaP's GridMap (4.2, 9.4): local environments at anchors around the object, blended per point.

`transfer.Transfer` is the better of the two; this is the paper's, with its weights by name (docs/physics.md,
Shading). Diffuse light is blended in the small prefiltered level first and evaluated once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.geometry.occluder import Occluder
from pipeline.optics.fresnel import hemispherical_transmittance

from .cube import cube_directions, lookup
from .prefilter import Level, LightField, Prefilter
from .prefilter_kernels import REFERENCE_IOR
from .shading import Occlusion

# "inverse-square": 1/d^2, the released code's. "printed": d, as Eq. 9 has it, which favours the farthest anchors.
WEIGHTS = ("inverse-square", "printed")
# Bounding box of the anchors against the object's.
MARGIN = 1.1


def anchors(vertices: NDArray, up: int = 1) -> NDArray[np.float64]:
    """52 points [52, 3]: 4 x 4 on every face of the enlarged bounding box but the 4 inside the bottom face."""
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    centre, half = (low + high) / 2, MARGIN * (high - low) / 2
    grid = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    border = (grid == 0) | (grid == 3)
    bottom = (grid[:, up] == 0) & ~np.delete(border, up, axis=1).any(1)
    return centre + half * (grid[border.any(1) & ~bottom] * (2 / 3) - 1)


@dataclass(frozen=True)
class LocalLight:
    """Prefiltered light at every anchor: packed [52, T, 3] as `LightField.packed`."""

    packed: torch.Tensor
    field: LightField


class GridMap:
    """Anchors' views of a mesh; `resolution`: their cubes' (the paper's 64 costs 52 x 24576 rays).

    albedo [V, 3] of the mesh. A ray that hits sends back albedo/pi x irradiance of the hit's normal (unoccluded, as
    the paper has it), a ray that misses the environment.
    """

    def __init__(
        self,
        occluder: Occluder,
        albedo: NDArray,
        *,
        resolution: int = 16,
        weights: str = "inverse-square",
        up: int = 1,
        lobe: str = "ggx",
    ) -> None:
        if weights not in WEIGHTS:
            raise ValueError(f"GridMap weights {weights!r}: must be one of {', '.join(WEIGHTS)}")
        self.occluder, self.weights, self.resolution = occluder, weights, resolution
        self.albedo = torch.as_tensor(np.asarray(albedo), dtype=torch.float32)
        self.anchors = anchors(occluder.vertices, up)
        self._prefilter = Prefilter(resolution, lobe)
        directions = cube_directions(resolution).reshape(-1, 3)
        origins = np.repeat(self.anchors, len(directions), axis=0)
        self._hits = occluder.cast(origins, np.tile(directions, (len(self.anchors), 1)))

    @cached_property
    def _normals(self) -> torch.Tensor:
        return torch.as_tensor(self.occluder.normals, dtype=torch.float32)

    def light(self, radiance: torch.Tensor, field: LightField) -> LocalLight:
        """Local environments under radiance [6, R, R, 3], R a multiple of the anchors' cubes; no gradient."""
        with torch.no_grad():
            ratio = radiance.shape[1] // self.resolution
            far = radiance.reshape(6, self.resolution, ratio, self.resolution, ratio, 3).mean((2, 4)).reshape(-1, 3)
            entering = float(hemispherical_transmittance(np.asarray(REFERENCE_IOR)))
            leaving = entering / torch.pi * self.albedo * field.irradiance(self._normals, transmitted=True)
            corners, w = torch.as_tensor(self._hits.vertices), torch.as_tensor(self._hits.weights)
            near = (leaving[corners] * w[..., None]).sum(1)
            count = len(self.anchors)
            seen = torch.where(torch.as_tensor(self._hits.blocked)[:, None], near, far.repeat(count, 1))
            cubes = seen.reshape(count, 6, self.resolution, self.resolution, 3)
            fields = [self._prefilter.apply(cube) for cube in cubes]
            return LocalLight(torch.stack([f.packed for f in fields]), fields[0])

    def blend(self, points: torch.Tensor) -> torch.Tensor:
        """Weights of the anchors at points [P, 3], summing to 1 [P, 52] (Eq. 9)."""
        square = ((points[:, None] - torch.as_tensor(self.anchors, dtype=points.dtype)) ** 2).sum(-1)
        if self.weights == "printed":
            weight = square.sqrt()
        else:
            # The floor, 1e-6 of the box's squared diagonal, meets a point that sits on an anchor.
            weight = 1 / (square + 1e-6 * float(np.ptp(self.anchors, axis=0) @ np.ptp(self.anchors, axis=0)))
        return weight / weight.sum(1, keepdim=True)

    def occlusion(
        self,
        points: torch.Tensor,  # [P, 3] world
        normals: torch.Tensor,  # [P, 3]
        view: torch.Tensor,  # [P, 3] towards the camera
        roughness: torch.Tensor,  # [P]
        local: LocalLight,
    ) -> Occlusion:
        """What `shade` needs: diffuse light from the anchors everywhere, mirrored light where the mirror ray hits."""
        weight = self.blend(points)
        mirror = 2 * (normals * view).sum(-1, keepdim=True) * normals - view
        origins = (points + self.occluder.lift * normals).numpy()
        blocked = torch.as_tensor(self.occluder.blocked(origins, mirror.numpy()))
        field = local.field
        diffuse = _blended(local.packed, field.transmitted, weight, normals)
        seen = torch.zeros_like(diffuse)
        if blocked.any():
            mean = torch.stack([replace(field, packed=p).mirrored(mirror[blocked], roughness[blocked]) for p in local.packed])
            seen[blocked] = torch.einsum("pa,apc->pc", weight[blocked], mean)
        return Occlusion(torch.zeros_like(diffuse), diffuse, (~blocked).to(diffuse.dtype), seen)


def _blended(packed: torch.Tensor, level: Level, weight: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """Lookup [P, 3] of a level in the directions, of the anchors' tables blended by weight [P, 52]."""
    tables = torch.stack([level.of(p) for p in packed])
    anchors_, rows, _ = tables.shape
    # Bilinear lookup is linear in the table: one lookup of all anchors side by side, then the blend.
    flat = lookup(tables.permute(1, 0, 2).reshape(rows, -1), directions, level.resolution)
    return torch.einsum("pa,pac->pc", weight, flat.reshape(len(directions), anchors_, 3))
