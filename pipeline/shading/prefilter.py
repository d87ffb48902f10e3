"""Prefiltered light: rough-mirror levels and diffuse irradiance of a cube, as one sparse linear map.

A level is the environment convolved with the lobe that a surface of that roughness reflects when mirror direction,
normal and view coincide (PhyGaP Eq. 16's second factor, normalised): weights D(h) (n.l), sum 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import torch
from scipy.sparse import csr_matrix, vstack

from pipeline.optics.fresnel import hemispherical_transmittance
from pipeline.optics.microfacet import MIN_ROUGHNESS
from pipeline.optics.sphere import cube_solid_angles

from . import prefilter_kernels, splitsum
from .cube import AXES, cube_directions, extended_size, lookup, lookup_at, padded_indices
from .light_tree import LightTree, light_tree
from .symmetry import SymmetricMap, representatives

LOBES = {"ggx": prefilter_kernels.GGX, "beckmann": prefilter_kernels.BECKMANN}
# Roughness of the levels; between them radiance is interpolated linearly.
ROUGHNESSES = (MIN_ROUGHNESS, 0.2, 0.3, 0.42, 0.55, 0.7, 0.85, 1.0)
# A level has at least this many texels across its lobe's full width at half maximum (up to the source's).
TEXELS_PER_LOBE = 4.5
DIFFUSE_RESOLUTION = 16
COARSEST = 4


@dataclass(frozen=True)
class Level:
    """A block of the packed table: an extended cube of this resolution from row `start`."""

    resolution: int
    start: int

    def of(self, packed: torch.Tensor) -> torch.Tensor:
        return packed[self.start : self.start + extended_size(self.resolution)]


@dataclass(frozen=True)
class LightField:
    """What a surface point sees of an unoccluded environment.

    Fields:
        packed: all levels one after another; carries the gradient. [T, 3]
        roughnesses: perceptual, of the `specular` levels.
        specular: mirrored light, one level a roughness.
        cosine: irradiance.
        transmitted: irradiance that passes into a surface of the reference IoR.
        lobe: "ggx" or "beckmann".
        resolution: of the environment's cube.
        pyramid: the unfiltered cube and its coarser means. [S, 3]
    """

    packed: torch.Tensor
    roughnesses: tuple[float, ...]
    specular: tuple[Level, ...]
    cosine: Level
    transmitted: Level
    lobe: str
    resolution: int  # of the environment's cube
    pyramid: torch.Tensor  # [S, 3] the unfiltered cube and its coarser means

    @cached_property
    def tree(self) -> LightTree:
        """The environment as `light_tree` sums it."""
        return light_tree(self.pyramid, self.resolution, COARSEST)

    def mirrored(self, directions: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
        """E(r, direction) [P, 3] for directions [P, 3] and perceptual roughness [P].

        Without a gradient, in float32 on the CPU, by one pass of a kernel.
        """
        given = (directions, roughness, self.packed)
        plain = torch.is_grad_enabled() and any(t.requires_grad for t in given)
        if plain or not all(t.device.type == "cpu" and t.dtype == torch.float32 for t in given):
            return self.mirrored_plainly(directions, roughness)
        from .mirrored_kernel import mirrored_rows

        out = torch.empty(directions.shape)
        arrays = [t.detach().contiguous().numpy() for t in given]
        mirrored_rows(*arrays, *self.tables()[:5], out.numpy())
        return out

    def mirrored_plainly(self, directions: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
        """`mirrored` in torch: the definition. Nothing in it waits for the device."""
        nodes, sizes, rows, begin = _level_rows(self.roughnesses, self.specular, roughness.device)
        nodes = nodes.to(roughness.dtype)
        k = torch.searchsorted(nodes, roughness.detach().contiguous(), right=True) - 1
        k = k.clamp(0, len(self.roughnesses) - 2)
        t = ((roughness - nodes[k]) / (nodes[k + 1] - nodes[k]))[:, None]
        below, above = (lookup_at(self.packed, directions, sizes[m], rows, begin[m]) for m in (k, k + 1))
        return (1 - t) * below + t * above

    def irradiance(self, normals: torch.Tensor, transmitted: bool) -> torch.Tensor:
        """Integral of L (n.w) d omega [P, 3], with T(n.w) at eta = 1.5 inside if `transmitted`."""
        level = self.transmitted if transmitted else self.cosine
        return lookup(level.of(self.packed), normals, level.resolution)

    def tables(self) -> tuple[np.ndarray, ...]:
        """What the fused kernels need beside `packed`: see `_fused_tables`."""
        return _fused_tables(self.roughnesses, (*self.specular, self.transmitted), self.lobe)


@lru_cache(maxsize=8)
def _level_rows(
    roughnesses: tuple[float, ...], levels: tuple[Level, ...], device: torch.device
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """What `cube.lookup_at` needs to look each direction up in a level of its own, copied to a device once.

    (roughness nodes [L] float64, resolutions [L], rows of the packed table under every level's padded cube [B], where each
    level's begin [L])
    """
    blocks = [padded_indices(level.resolution).ravel().astype(np.int64) + level.start for level in levels]
    begin = np.concatenate(([0], np.cumsum([len(block) for block in blocks])[:-1]))
    sizes = np.array([level.resolution for level in levels])
    nodes, *others = (torch.as_tensor(a, device=device) for a in (np.array(roughnesses), sizes, np.concatenate(blocks), begin))
    return nodes, others[0], others[1], others[2]


@lru_cache(maxsize=8)
def _fused_tables(roughnesses: tuple[float, ...], levels: tuple[Level, ...], lobe: str) -> tuple[np.ndarray, ...]:
    """(roughness nodes, sizes, starts, padded indices of all sizes, where each level's begin, split-sum table)."""
    sizes = sorted({level.resolution for level in levels})
    pads = [padded_indices(n).ravel() for n in sizes]
    begin = dict(zip(sizes, np.concatenate(([0], np.cumsum([len(p) for p in pads])))))
    return (
        np.array(roughnesses, np.float32),
        np.array([level.resolution for level in levels]),
        np.array([level.start for level in levels]),
        np.concatenate(pads),
        np.array([begin[level.resolution] for level in levels]),
        splitsum.exact_table(lobe),
    )


class Prefilter:
    """The linear map from a cube's radiance [6, R, R, 3] to a `LightField`, built once per (R, lobe)."""

    def __init__(self, resolution: int = 32, lobe: str = "ggx") -> None:
        """Build the map.

        Args:
            resolution: R, texels on a face's side: a power of two from `COARSEST` up.
            lobe: "ggx" (PhyGaP) or "beckmann" (Mitsuba's pplastic).

        Raises:
            ValueError: neither a fit resolution nor a known lobe.
        """
        if resolution < COARSEST or resolution & (resolution - 1):
            raise ValueError(f"environment resolution {resolution}: must be a power of two from {COARSEST} up")
        if lobe not in LOBES:
            raise ValueError(f"lobe {lobe!r}: must be one of {', '.join(LOBES)}")
        self.resolution, self.lobe = resolution, lobe
        self.operator, self.levels = _build(resolution, lobe)

    def apply(self, radiance: torch.Tensor) -> LightField:
        """Prefilter radiance [6, R, R, 3]; differentiable."""
        *specular, cosine, transmitted = self.levels
        means = pyramid(radiance)
        packed = self.operator(means)
        return LightField(packed, ROUGHNESSES, tuple(specular), cosine, transmitted, self.lobe, self.resolution, means)


def level_resolution(roughness: float, limit: int) -> int:
    """Cube resolution of a specular level: a power of two, fine enough for its lobe."""
    width_deg = 4 * np.degrees(np.arctan(0.6436 * roughness**2))
    need = TEXELS_PER_LOBE * 90 / width_deg
    return int(min(limit, max(DIFFUSE_RESOLUTION, 2 ** np.ceil(np.log2(need)))))


@lru_cache(maxsize=4)
def _build(resolution: int, lobe: str) -> tuple[SymmetricMap, tuple[Level, ...]]:
    sizes = pyramid_sizes(resolution)
    entering = float(hemispherical_transmittance(np.asarray(prefilter_kernels.REFERENCE_IOR)))
    diffuse = min(resolution, DIFFUSE_RESOLUTION)
    wanted = [(LOBES[lobe], r**2, level_resolution(r, resolution), 1.0) for r in ROUGHNESSES]
    wanted += [(prefilter_kernels.COSINE, 1.0, diffuse, np.pi), (prefilter_kernels.TRANSMITTED, 1.0, diffuse, np.pi * entering)]
    blocks, levels, start = [], [], 0
    for kind, alpha, size, total in wanted:
        blocks.append(_rows(kind, alpha, size, total, sizes))
        levels.append(Level(size, start))
        start += extended_size(size)
    return SymmetricMap(sizes, [level.resolution for level in levels], vstack(blocks)), tuple(levels)


def pyramid_sizes(resolution: int) -> list[int]:
    """Resolutions of a cube and its ever coarser means."""
    sizes = [resolution]
    while sizes[-1] > COARSEST:
        sizes.append(sizes[-1] // 2)
    return sizes


@lru_cache(maxsize=16)
def _shares(resolution: int) -> np.ndarray:
    """Share of each texel of a face in the solid angle of its parent [1, R, R, 1]."""
    parent = cube_solid_angles(resolution // 2).repeat(2, 0).repeat(2, 1)
    return (cube_solid_angles(resolution) / parent)[None, :, :, None]


def pyramid(radiance: torch.Tensor) -> torch.Tensor:
    """A cube's texels [6, R, R, C] and their means in all coarser cubes, stacked [S, C]."""
    levels = [radiance]
    for size in pyramid_sizes(radiance.shape[1])[1:]:
        share = torch.as_tensor(_shares(2 * size), dtype=radiance.dtype, device=radiance.device)
        fine = levels[-1] * share
        levels.append(fine.reshape(6, size, 2, size, 2, -1).sum((2, 4)))
    return torch.cat([level.reshape(-1, radiance.shape[-1]) for level in levels])


def _rows(kind: int, alpha: float, size: int, total: float, sizes: list[int]) -> csr_matrix:
    """Weights of one level at the representatives of its texels, which sum to `total`."""
    offsets = np.concatenate(([0], np.cumsum([6 * n * n for n in sizes])))
    directions = cube_directions(size).reshape(-1, 3)[representatives(size)[0]]
    few = size <= prefilter_kernels.FEW and kind != prefilter_kernels.COSINE  # plain cosine: for "schlick" alone
    accept = prefilter_kernels.ACCEPT_FEW if few else prefilter_kernels.ACCEPT
    where = (kind, float(alpha), accept, directions, AXES, sizes[0], len(sizes), offsets)
    starts = np.concatenate(([0], np.cumsum(prefilter_kernels.count_rows(*where))))
    columns, values = np.empty(starts[-1], np.int32), np.empty(starts[-1])
    prefilter_kernels.fill_rows(*where, total, starts, columns, values)
    return csr_matrix((values, columns, starts), shape=(len(directions), offsets[-1]))
