"""Mirrored light as a sum over a tree of cube texels: as fine as the lobe asks for, wherever it asks.

A node stands for a square of texels: their mean radiance, the direction in which their light is centred, and its spread.
Going down from the coarsest cube, a node is taken whole where the lobe hardly changes over it, in slopes of the half vector;
else its four children are. Texels wider than the lobe are cut into cells that read the bilinear environment. So the sum is
a quadrature of the lobe itself (Beckmann or GGX, Smith, exact Fresnel, each facet's own polarisation), narrow lamps stand
where they are, and no pattern of samples shows. The result is relative to the lobe's albedo, which stays the table's
(`splitsum`): the weights are divided by their sum, so that a constant environment is mirrored exactly.

Nodes are chosen without a gradient; the weights carry it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.optics.sphere import cube_solid_angles

from .cube import cube_directions, texel_index

# Halvings of a texel's tent (two texels wide) at most: 64 cells across cut a texel of 11 degrees (a cube of 8) to a third of
# the narrowest lobe's width, alpha = 0.0064.
MOST_HALVINGS = 6
# Light that nodes are taken to hold beside their own, as a share of the environment's mean: a black node has a centre.
FAINT = 1e-3


@dataclass(frozen=True)
class TreeShape:
    """What a tree of one resolution has whatever its light: S nodes, the finest cube first, as in `prefilter.pyramid`."""

    resolution: int
    coarsest: int
    direction: NDArray[np.float32]  # [S, 3] centres
    solid_angle: NDArray[np.float32]  # [S] sr
    radius: NDArray[np.float32]  # [S] from the centre to the farthest corner, rad
    child: NDArray[np.int32]  # [S, 4] nodes one finer, -1 for texels

    @property
    def first_root(self) -> int:
        """Where the coarsest cube begins."""
        return len(self.child) - 6 * self.coarsest**2


@dataclass(frozen=True)
class LightTree:
    """An environment as a tree; radiance [S, 3], the nodes' means, carries the gradient."""

    shape: TreeShape
    radiance: torch.Tensor
    place: torch.Tensor  # [S, 5] direction in which a node's light is centred, variance along either axis (rad^2), share of all


@lru_cache(maxsize=8)
def tree_shape(resolution: int, coarsest: int) -> TreeShape:
    """The tree over a cube of `resolution`, a power of two times `coarsest`."""
    sizes = [resolution]
    while sizes[-1] > coarsest:
        sizes.append(sizes[-1] // 2)
    starts = np.concatenate(([0], np.cumsum([6 * n * n for n in sizes])))
    directions, angles, radii, children = [], [], [], []
    for k, n in enumerate(sizes):
        centre = cube_directions(n)
        directions.append(centre.reshape(-1, 3))
        angles.append(np.tile(cube_solid_angles(n), (6, 1, 1)).ravel())
        radii.append(_radius(n).ravel())
        if k == 0:
            children.append(np.full((6 * n * n, 4), -1))
            continue
        face, j, i = np.meshgrid(np.arange(6), np.arange(n), np.arange(n), indexing="ij")
        first = starts[k - 1] + (face * 2 * n + 2 * j) * 2 * n + 2 * i
        children.append(np.stack([first, first + 1, first + 2 * n, first + 2 * n + 1], -1).reshape(-1, 4))
    return TreeShape(
        resolution,
        coarsest,
        np.concatenate(directions).astype(np.float32),
        np.concatenate(angles).astype(np.float32),
        np.concatenate(radii).astype(np.float32),
        np.concatenate(children).astype(np.int32),
    )


def _radius(n: int) -> NDArray[np.float64]:
    """Angle from each texel's centre to its farthest corner [6, n, n]."""
    edge = np.linspace(-1, 1, n + 1)
    u, v = np.meshgrid(edge, edge)
    corner = np.stack([np.ones_like(u), u, v], -1)
    corner /= np.linalg.norm(corner, axis=-1, keepdims=True)
    middle = (edge[1:] + edge[:-1]) / 2
    u, v = np.meshgrid(middle, middle)
    centre = np.stack([np.ones_like(u), u, v], -1)
    centre /= np.linalg.norm(centre, axis=-1, keepdims=True)
    four = (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:])
    chord = np.stack([np.linalg.norm(c - centre, axis=-1) for c in four]).max(0)
    return np.tile(2 * np.arcsin(chord / 2), (6, 1, 1))


def light_tree(pyramid: torch.Tensor, resolution: int, coarsest: int) -> LightTree:
    """The tree of a cube's texels and their coarser means [S, 3] (`prefilter.pyramid`); differentiable in the radiance."""
    shape = tree_shape(resolution, coarsest)
    with torch.no_grad():
        place = _places(pyramid.detach(), shape)
    return LightTree(shape, pyramid, place)


def _places(radiance: torch.Tensor, shape: TreeShape) -> torch.Tensor:
    """Where each node's light is centred, its variance and its share of all light [S, 5]."""
    like: dict[str, Any] = {"dtype": radiance.dtype, "device": radiance.device}
    finest = 6 * shape.resolution**2
    angle = torch.as_tensor(shape.solid_angle, **like)
    bright = radiance[:finest].sum(1)
    # Of the mean: squares of faint or strong light stay inside float32, and a black cube's nodes have centres.
    weight = angle[:finest] * (bright / bright.mean().clamp_min(torch.finfo(radiance.dtype).tiny) + FAINT)
    moment = weight[:, None] * torch.as_tensor(shape.direction[:finest], **like)
    # A texel's light is a tent over its neighbours: a sixth of its width squared along either axis.
    out, spread, all_ = [], angle[:finest] / 6 * weight, weight.sum()
    size = shape.resolution
    while True:
        length = moment.norm(dim=1)
        # Variance of directions about their mean: one minus the mean resultant length.
        variance = (weight - length).clamp_min(0) / weight + spread / weight
        out.append(torch.cat((moment / length[:, None], variance[:, None], (weight / all_)[:, None]), 1))
        if size == shape.coarsest:
            return torch.cat(out)
        size //= 2
        weight, spread, moment = (
            x.reshape(6, size, 2, size, 2, -1).sum((2, 4)).reshape(6 * size * size, -1) for x in (weight, spread, moment)
        )
        weight, spread = weight[:, 0], spread[:, 0]


def straight_ahead(normal: torch.Tensor, view: torch.Tensor, resolution: int) -> torch.Tensor:
    """Texels [P] in the mirror directions."""
    n, v = normal.detach(), view.detach()
    return texel_index(2 * (n * v).sum(1, keepdim=True) * n - v, resolution)


def mirrored(
    normal: torch.Tensor,
    view: torch.Tensor,
    roughness: torch.Tensor,
    ior: torch.Tensor,
    frame_x: torch.Tensor,
    frame_y: torch.Tensor,
    tree: LightTree,
    lobe: str,
    tolerance: float,
) -> tuple[torch.Tensor, torch.Tensor]:
    """`light_tree_plain.plain` as a fused kernel: float32, CPU; clamps roughness and ior itself."""
    return _Tree.apply(tree, lobe, tolerance, normal, view, roughness, ior, frame_x, frame_y, tree.radiance)


class _Tree(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, tree: LightTree, lobe: str, tolerance: float, *tensors: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        from . import light_tree_kernels

        shape = tree.shape
        arrays = [x.detach().contiguous().numpy() for x in tensors]
        table = (tree.place.contiguous().numpy(), shape.solid_angle, shape.radius, shape.child, shape.first_root)
        fixed = (*table, shape.resolution, float(tolerance), MOST_HALVINGS, lobe == "ggx")
        points = len(arrays[0])
        value, turned, total = torch.empty(points, 3), torch.empty(points, 2, 3), np.empty(points, np.float32)
        kernel: Any = light_tree_kernels.forward
        kernel(*arrays, *fixed, value.numpy(), turned.numpy(), total)
        hidden = torch.as_tensor(np.flatnonzero(~(total > 0)))
        ahead = straight_ahead(tensors[0][hidden], tensors[1][hidden], shape.resolution)
        value[hidden] = tensors[6].detach()[ahead]
        ctx.arrays, ctx.fixed, ctx.sums, ctx.straight = arrays, fixed, (value.numpy(), turned.numpy(), total), (hidden, ahead)
        return value, turned

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        from . import light_tree_kernels
        from .shade_kernels import chunks

        normal, view, roughness, ior, _, _, radiance = ctx.arrays
        tables = torch.zeros(chunks(len(normal)), *radiance.shape)
        new = [torch.empty(x.shape) for x in (normal, view, roughness, ior)]
        kernel: Any = light_tree_kernels.backward
        given = [g.contiguous().numpy() for g in gradients]
        kernel(*ctx.arrays, *ctx.fixed, *ctx.sums, *given, *(x.numpy() for x in new), tables.numpy())
        hidden, ahead = ctx.straight
        return (None, None, None, *new, None, None, tables.sum(0).index_add_(0, ahead, gradients[0][hidden]))
