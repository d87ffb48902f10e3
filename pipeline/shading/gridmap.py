"""PhyGaP's GridMap (4.2, 9.4, 10.4): local environments at anchors around the object, blended per point.

`transfer.Transfer` is the better of the two; this is the paper's, with its weights and its places of anchors by name
(docs/physics.md, Shading). A small prefiltered level holds all that diffuse light needs of an anchor, so that a point costs a
blend of four texels an anchor, not 52 full lookups, and the anchors' texels lie side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.geometry.occluder import Occluder
from pipeline.kernels.simd import LANES
from pipeline.kernels.threads import row_buffers, run_on_all_cores
from pipeline.optics.fresnel import hemispherical_transmittance
from pipeline.optics.model_names import ANCHOR_PLACES, ANCHOR_WEIGHTS

from . import gridmap_kernels as kernels
from .anchors import box_anchors, surface_anchors
from .cube import cube_directions, extend, lookup, padded_indices
from .prefilter import Level, LightField, Prefilter
from .prefilter_kernels import REFERENCE_IOR
from .shading import Occlusion

RESOLUTION = 64
"""D of an anchor's cube (PhyGaP 9.4)."""
NEAREST = 4
"""Neighbours of the kNN albedo: PhyGaP names no number; a surface point has about this many splats or vertices around it."""
# Weights' floor over the box's squared diagonal: it only meets a point that sits on an anchor.
FLOOR = 1e-6
ROWS = 512  # of the anchors' tables that are laid side by side at a time
TILT = 0.05  # of a normal, by which the irradiance's slope is taken: half a texel of the diffuse level


def nearest_albedo(points: NDArray, albedo: NDArray, at: NDArray) -> NDArray[np.float32]:
    """Find the albedo around places: the mean over the NEAREST points.

    Args:
        points: positions. [N, 3]
        albedo: of the points. [N, 3]
        at: positions asked for. [V, 3]

    Returns:
        Mean albedo. [V, 3]
    """
    from scipy.spatial import cKDTree

    _, index = cKDTree(points).query(at, k=range(1, min(NEAREST, len(points)) + 1))
    return np.asarray(albedo, np.float32)[index].mean(1)


@dataclass(frozen=True)
class LocalLight:
    """Prefiltered light at each of A anchors.

    Fields:
        tables: rows as those of `field.packed`; 0 from the last anchor on. [T, 3, A, up to whole LANES]
        field: says which rows are what (`LightField`).
    """

    tables: NDArray[np.float32]
    field: LightField


class GridMap:
    """Anchors' views of a mesh; `resolution`: their cubes' (52 x 6 x 64^2 rays as the paper has it).

    A ray that hits sends back albedo/pi x irradiance of the hit's normal (unoccluded, as the paper has it), a ray that misses
    the environment.

    Args:
        occluder: the mesh, V vertices.
        albedo: at its vertices (`nearest_albedo`); interpolated where rays hit. [V, 3]
        resolution: D, a power of two.
        weights: "inverse-square", the authors' program's; "printed", Eq. 9's, which grow with distance.
        anchors: "box", on the enlarged bounding box; "surface", close to the object (10.4).
        up: axis of the box whose lower face has no inner anchors.
        lobe: of the mirrored light.
        fresnel: "exact" (light passes into and out of the surface) or "schlick" (Eq. 20).
    """

    def __init__(
        self,
        occluder: Occluder,
        albedo: NDArray,
        *,
        resolution: int = RESOLUTION,
        weights: str = "inverse-square",
        anchors: str = "box",
        up: int = 1,
        lobe: str = "ggx",
        fresnel: str = "exact",
    ) -> None:
        if weights not in ANCHOR_WEIGHTS or anchors not in ANCHOR_PLACES:
            raise ValueError(f"GridMap {weights!r}, {anchors!r}: of {', '.join(ANCHOR_WEIGHTS)} and {', '.join(ANCHOR_PLACES)}")
        self.occluder, self.weights, self.resolution, self.fresnel = occluder, weights, resolution, fresnel
        self.albedo = torch.as_tensor(np.asarray(albedo), dtype=torch.float32)
        self.anchors = box_anchors(occluder.vertices, up) if anchors == "box" else surface_anchors(occluder)
        self._prefilter = Prefilter(resolution, lobe)
        rays = np.empty((6 * resolution**2, 6), np.float32)
        rays[:, 3:] = cube_directions(resolution).reshape(-1, 3)
        found = []
        for a, place in enumerate(self.anchors):
            rays[:, :3] = place
            rows, vertices, shares = occluder.met(rays)
            found.append((rows + a * len(rays), vertices, shares))
        self._hit, self._corners, self._share = (torch.as_tensor(np.concatenate(part)) for part in zip(*found))

    @cached_property
    def _normals(self) -> torch.Tensor:
        return torch.as_tensor(self.occluder.normals, dtype=torch.float32)

    @property
    def floor(self) -> float:
        """What is added to squared distances."""
        box = np.ptp(self.anchors, axis=0)
        return FLOOR * float(box @ box)

    def light(self, radiance: torch.Tensor, field: LightField) -> LocalLight:
        """Local environments under radiance [6, R, R, 3], of which `field` is the prefiltered light; no gradient."""
        with torch.no_grad():
            far = self._far(radiance.detach().cpu().float())
            leaving = self._leaving(field)
            count = len(self.anchors)
            seen = far.repeat(count, 1)
            seen[self._hit] = (leaving[self._corners] * self._share[..., None]).sum(1)
            fields = [self._prefilter.apply(cube) for cube in seen.reshape(count, 6, self.resolution, self.resolution, 3)]
            packed = torch.stack([f.packed for f in fields])
            tables = torch.zeros(*packed.shape[1:], self._places.shape[1])
            for first in range(0, len(tables), ROWS):  # within a core's cache, as it is turned
                rows = slice(first, first + ROWS)
                tables[rows, :, :count] = packed[:, rows].permute(1, 2, 0)
            return LocalLight(tables.numpy(), fields[0])

    def _far(self, radiance: torch.Tensor) -> torch.Tensor:
        """The environment in an anchor's texels [6 D^2, 3]: means of its own, or between them where they are larger."""
        size, own = self.resolution, radiance.shape[1]
        if own > size:
            ratio = own // size
            return radiance.reshape(6, size, ratio, size, ratio, 3).mean((2, 4)).reshape(-1, 3)
        if own == size:
            return radiance.reshape(-1, 3)
        directions = torch.as_tensor(cube_directions(size).reshape(-1, 3), dtype=torch.float32)
        return lookup(extend(radiance), directions, own)

    def _leaving(self, field: LightField) -> torch.Tensor:
        """Diffuse radiance [V, 3] of the mesh's vertices."""
        exact = self.fresnel == "exact"
        out = float(hemispherical_transmittance(np.asarray(REFERENCE_IOR))) if exact else 1.0
        return out / torch.pi * self.albedo * field.irradiance(self._normals, transmitted=exact).detach().cpu()

    @cached_property
    def _places(self) -> NDArray[np.float32]:
        """The anchors [3, A, up to whole LANES]."""
        count = len(self.anchors)
        return np.ascontiguousarray(np.pad(self.anchors.T.astype(np.float32), ((0, 0), (0, -count % LANES))))

    def _run(self, kernel: Any, *given: Any) -> None:
        """Call a kernel of lookups on all cores: what goes before the anchors and what follows them, the last output apart."""
        before, after = given
        anchors = (self._places, len(self.anchors), self.weights == "printed", np.float32(self.floor))
        run_on_all_cores(kernel, *before, *anchors, *after)

    def received(self, points: NDArray, normals: NDArray, local: LocalLight) -> NDArray[np.float32]:
        """Irradiance [P, 3] at points [P, 3] by normals [P, 3] of the anchors' light, blended (Eq. 9)."""
        return self._received(points, normals, local, False)[0]

    def received_and_slope(
        self, points: NDArray, normals: NDArray, local: LocalLight
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """`received`, and its change [P, 3, 3] with the unit normal, across it."""
        return self._received(points, normals, local, True)

    def _received(
        self, points: NDArray, normals: NDArray, local: LocalLight, sloping: bool
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        level = local.field.transmitted if self.fresnel == "exact" else local.field.cosine
        out = np.empty((len(points), 3), np.float32)
        slope = np.empty((len(points) if sloping else 0, 3, 3), np.float32)
        where = local.tables, level.start, level.resolution, padded_indices(level.resolution).ravel(), np.float32(TILT)
        self._run(kernels.receive, (_single(points), _single(normals)), (*where, self._workspace(), out, slope))
        return out, slope

    def mirrored(
        self, points: NDArray, directions: NDArray, roughness: NDArray, rows: NDArray[np.int64], local: LocalLight
    ) -> NDArray[np.float32]:
        """E(roughness, direction) [P, 3] of the anchors' light, blended; of the points `rows` alone, 0 elsewhere."""
        out = np.zeros((len(points), 3), np.float32)
        where = local.tables, *local.field.tables()[:5]
        given = (_single(points), _single(directions), _single(roughness), rows)
        self._run(kernels.reflect, given, (*where, self._workspace(), out))
        return out

    def _workspace(self) -> NDArray[np.float32]:
        return row_buffers(self._places.shape[1] + kernels.TOTALS)

    def occlusion(
        self,
        points: NDArray,  # [P, 3] world
        normals: NDArray,  # [P, 3]
        view: NDArray,  # [P, 3] towards the camera
        roughness: NDArray,  # [P]
        local: LocalLight,
        blocked: NDArray[np.bool_] | None = None,  # [P]
    ) -> Occlusion:
        """What `shade` needs: diffuse light from the anchors everywhere, mirrored light where the mirror ray hits.

        blocked: whether it does, where the caller has found out; else a ray is cast from each point.
        """
        mirror = 2 * np.einsum("pk,pk->p", normals, view)[:, None] * normals - view
        if blocked is None:
            blocked = self.occluder.blocked(points + self.occluder.lift * normals, mirror)
        diffuse = torch.as_tensor(self.received(points, normals, local))
        seen = torch.as_tensor(self.mirrored(points, mirror, roughness, np.flatnonzero(blocked), local))
        free = torch.as_tensor((~blocked).astype(np.float32))
        return Occlusion(torch.zeros_like(diffuse), diffuse, free, seen)


def _single(values: NDArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)


def plain_weights(points: torch.Tensor, anchors: torch.Tensor, weights: str, floor: float) -> torch.Tensor:
    """Weights of the anchors in torch: the definition. points [P, 3], anchors [A, 3] -> [P, A]."""
    square = ((points[:, None] - anchors) ** 2).sum(-1)
    weight = square.sqrt() if weights == "printed" else 1 / (square + floor)
    return weight / weight.sum(1, keepdim=True)


def plain_blend(tables: torch.Tensor, level: Level, weight: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """Lookup [P, 3] of a level in the directions [P, 3], of tables [T, 3, A] blended by weight [P, A]: the definition."""
    rows = level.of(tables)
    flat = lookup(rows.reshape(len(rows), -1), directions, level.resolution)
    return torch.einsum("pa,pca->pc", weight, flat.reshape(len(directions), 3, -1))
