"""Shadows of an environment's bright parts with their edges where they are, and what they leave of mirrored light.

`transfer` knows visibility at the mesh's vertices, in texels 6 degrees wide, and of a mirrored lobe in a few directions: a
lamp's shadow has the steps of mesh and texels for edges, and a lobe that meets an edge counts its share of directions where
the lamp may be all its light. Here the bright parts (`bright_parts`) are looked at one by one: where the vertices around a
point agree, as they do; elsewhere by a ray. The rest of the light, which is even, stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pipeline.optics.model_names import TREES

from . import light_tree, limits
from . import sharp_kernels as kernels
from .bright_parts import BrightParts, bright_parts
from .prefilter import LightField
from .shading import Occlusion, mirror_reflection
from .transfer import Attachment, Gathering, SurfaceLight, Transfer

BLOCK = 32_768  # points at a time: some 10 MB
FAINT = 1e-4  # of the environment's mean: mirrored by a dielectric, it is below what 8 bits show


@dataclass(frozen=True)
class Points:
    """P shaded points in the transfer's frame, all float32."""

    position: NDArray  # [P, 3] on the mesh
    normal: NDArray  # [P, 3] unit
    view: NDArray  # [P, 3] unit, towards the camera
    roughness: NDArray  # [P]
    ior: NDArray  # [P]

    @classmethod
    def of(cls, *values: NDArray) -> Points:
        """From values of any type."""
        return cls(*(np.ascontiguousarray(v, np.float32) for v in values))

    def part(self, rows: NDArray | slice) -> Points:
        """Some of them."""
        return Points(*(v[rows] for v in (self.position, self.normal, self.view, self.roughness, self.ior)))


class SharpShadows:
    """The bright parts of one environment behind one mesh.

    Args:
        transfer: the mesh, and what its vertices see.
        light: of the environment (`Transfer.light`).
        field: the environment, prefiltered.
    """

    def __init__(self, transfer: Transfer, light: SurfaceLight, field: LightField) -> None:
        self.transfer, self.field = transfer, field
        self.parts: BrightParts = bright_parts(field.tree, transfer.resolution)
        self._dark = light.texels.clone()
        self._dark[torch.as_tensor(self.parts.texels)] = 0
        self._rest = self._taken(transfer.vertices, light)
        self._faint = FAINT * float(light.texels.sum(1).mean())
        seen = transfer.sees(transfer.vertices, self.parts.texels)
        around: csr_matrix = _neighbours(transfer.occluder.triangles, len(seen))
        self._some = (around @ seen.astype(np.float32)) > 0
        self._every = (around @ (~seen).astype(np.float32)) == 0

    def occlusion(self, points: Points, attachment: Attachment, light: SurfaceLight) -> Occlusion:
        """`Transfer.occlusion`, with the shadows of the bright parts point by point."""
        base = self.transfer.occlusion(attachment, light)
        if not len(self.parts.owner):
            return base
        rest = self._taken(attachment.gathered, light) if attachment.gathered is not None else (
            self._rest[attachment.vertices] * attachment.weights[..., None]
        ).sum(1)  # fmt: skip
        parts = []
        for start in range(0, len(points.normal), BLOCK):
            rows = slice(start, start + BLOCK)
            parts.append(self._block(points.part(rows), attachment.vertices[rows].numpy(), rest[rows], base.unblocked[rows]))
        shadow, unblocked = (torch.cat(p) for p in zip(*parts)) if parts else (base.shadow, base.unblocked)
        return replace(base, shadow=shadow, unblocked=unblocked)

    def _block(
        self, points: Points, corners: NDArray[np.int64], rest: torch.Tensor, free: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Shares of irradiance [P, 3] and of mirrored light [P] that arrive.

        corners [P, 3]: vertices around the points; rest [P, 3]: share of irradiance that the mesh takes of even light;
        free [P]: share of directions of the lobe that leave the mesh.
        """
        p, parts = points, self.parts
        state = np.empty((len(p.normal), len(parts.owner)), np.uint8)
        kernels.classify(p.normal, corners, self._some, self._every, parts.owner, parts.direction, state)
        point, leaf = np.nonzero(state == kernels.DOUBTFUL)
        starts = p.position[point] + self.transfer.occluder.lift * p.normal[point]
        blocked = self.transfer.occluder.cast(starts, parts.direction[leaf]).blocked
        state[point, leaf] = np.where(blocked, kernels.HIDDEN, kernels.VISIBLE)
        taken, whole, lost = np.empty((len(state), 3), np.float32), *np.empty((2, len(state)), np.float32)
        surface = (p.normal, p.view, p.roughness, p.ior)
        leaves = (parts.direction, parts.solid_angle, parts.variance, parts.radiance)
        kernels.sums(*surface, state, *leaves, self.field.lobe == "ggx", taken, whole, lost)
        arriving = self.field.irradiance(torch.as_tensor(p.normal), transmitted=True)
        shadow = 1 - rest - torch.as_tensor(taken) / arriving.clamp_min(torch.finfo(arriving.dtype).tiny)
        return shadow.clamp(0, 1), self._mirrored(p, whole, lost, free)

    def _mirrored(self, points: Points, whole: NDArray, lost: NDArray, free: torch.Tensor) -> torch.Tensor:
        """Share of mirrored light that arrives [P]: of the bright parts `whole` [P] all but `lost`, of the rest `free` [P]."""
        rows = np.flatnonzero((lost > self._faint) | ((free.numpy() < 1) & (whole > self._faint)))
        p, out = points.part(rows), free.clone()
        if not len(rows):
            return out
        normal, view, roughness, ior = (torch.as_tensor(v) for v in (p.normal, p.view, p.roughness, p.ior))
        axes = torch.zeros_like(normal)  # of the pixels: for polarisation alone
        rough, eta = roughness.clamp(limits.MIN_ROUGHNESS, limits.MAX_ROUGHNESS), ior.clamp_min(limits.MIN_IOR)
        facing = (normal * view).sum(-1).clamp(limits.MIN_COSINE, 1.0)
        albedo, _ = mirror_reflection(normal, facing, rough, eta, axes, axes, self.field.lobe, "exact")
        all_, off = (torch.as_tensor(v[rows]) / albedo.clamp_min(1e-9) for v in (whole, lost))
        tree = (self.field.tree, self.field.lobe, TREES["tree-coarse"])
        mirrored = torch.maximum(light_tree.mirrored(normal, view, roughness, ior, axes, axes, *tree)[0].sum(1), all_)
        out[rows] = ((free[rows] * (mirrored - all_) + all_ - off) / mirrored.clamp_min(1e-30)).clamp(0, 1)
        return out

    def _taken(self, at: Gathering, light: SurfaceLight) -> torch.Tensor:
        """Share of irradiance [N, 3] that the mesh takes of what is not bright."""
        arriving = self.transfer.arriving(at, light.texels)
        return self.transfer.blocked(at, self._dark) / arriving.clamp_min(torch.finfo(arriving.dtype).tiny)


def _neighbours(triangles: NDArray, count: int) -> csr_matrix:
    """Which of `count` vertices share a triangle [V, V], each with itself."""
    corner = np.repeat(triangles.astype(np.int64), 3, axis=1).ravel()
    other = np.tile(triangles.astype(np.int64), (1, 3)).ravel()
    alone = np.arange(count)
    pairs = np.concatenate([corner, alone]), np.concatenate([other, alone])
    return csr_matrix((np.ones(len(pairs[0]), np.float32), pairs), shape=(count, count))
