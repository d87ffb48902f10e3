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

from pipeline.optics import fresnel, microfacet
from pipeline.optics.sphere import cube_solid_angles
from pipeline.optics.stokes import surface_pattern

from . import limits
from .cube import AXES, cube_directions, texel_index

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
    weight = angle[:finest] * (bright + FAINT * bright.mean() + torch.finfo(radiance.dtype).tiny)
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


@dataclass(frozen=True)
class _Leaves:
    """What the lobes of many points are summed over: L leaves."""

    point: torch.Tensor  # [L]
    node: torch.Tensor  # [L] whose radiance arrives
    direction: torch.Tensor  # [L, 3]
    solid_angle: torch.Tensor  # [L]
    variance: torch.Tensor  # [L]


def _leaves(
    normal: torch.Tensor, view: torch.Tensor, alpha: torch.Tensor, tree: LightTree, lobe: str, tolerance: float
) -> _Leaves:
    """Go down the tree for all points at once, one level after the other."""
    shape = tree.shape
    like: dict[str, Any] = {"dtype": normal.dtype, "device": normal.device}
    angles, radii = (torch.as_tensor(x, **like) for x in (shape.solid_angle, shape.radius))
    child = torch.as_tensor(shape.child, device=normal.device).long()
    place = tree.place.to(**like)
    points = torch.nonzero((normal * view).sum(1) > limits.AWAY)[:, 0]
    roots = torch.arange(shape.first_root, len(child), device=normal.device)
    point, node = points.repeat_interleave(len(roots)), roots.repeat(len(points))
    depth, across, down = (torch.zeros_like(point) for _ in range(3))
    found: list[tuple[torch.Tensor, ...]] = []
    while len(point):
        texel = child[node, 0] < 0
        direction, angle, variance = _cells(node, depth, across, down, shape.resolution, like)
        whole = depth == 0
        direction = torch.where(whole[:, None], place[node, :3], direction)
        angle = torch.where(whole, angles[node], angle)
        variance = torch.where(whole, place[node, 3], variance)
        wide = radii[node] * torch.where(whole, torch.where(texel, 2**0.5, 1.0), 2.0 / 2.0**depth)
        nl, nv = (normal[point] * direction).sum(1), (normal * view).sum(1)[point]
        square = (2 + 2 * (view[point] * direction).sum(1)).clamp_min(1e-6)
        turn = wide / square.sqrt()
        near = ((1 - (nv + nl) ** 2 / square).clamp_min(0).sqrt() - turn).clamp_min(0) ** 2
        a2 = alpha[point] ** 2
        allowed = tolerance * (a2 * (1 - near) + near) / alpha[point]
        go = nl >= -2 * wide
        if lobe == "beckmann":
            go &= near <= limits.BECKMANN_END * a2 * (1 - near)
        # Within the lobe, bright nodes that the horizon crosses are cut, and texels over which Fresnel's term bends.
        bends = (nl.abs() < wide) | (texel & (turn > tolerance / 4))
        cut = (depth < 2) & (near < 4 * a2) & (place[node, 4] > limits.BRIGHT) & bends
        done = ((turn <= allowed) & ~cut) | (texel & (depth >= MOST_HALVINGS))
        take = go & done & (nl > 0)
        found.append((point[take], node[take], direction[take], angle[take], variance[take]))
        split = go & ~done
        coarse, fine = split & ~texel, split & texel
        quarter = torch.arange(4, device=normal.device)
        point = torch.cat((point[coarse].repeat_interleave(4), point[fine].repeat_interleave(4)))
        below, count = child[node[coarse]].reshape(-1), 4 * int(coarse.sum())
        none = torch.zeros(count, dtype=node.dtype, device=node.device)
        turns = quarter.repeat(int(fine.sum()))
        node = torch.cat((below, node[fine].repeat_interleave(4)))
        across = torch.cat((none, 2 * across[fine].repeat_interleave(4) + (turns & 1)))
        down = torch.cat((none, 2 * down[fine].repeat_interleave(4) + (turns >> 1)))
        depth = torch.cat((none, depth[fine].repeat_interleave(4) + 1))
    return _Leaves(*(torch.cat(parts) for parts in zip(*found)))


def _cells(
    node: torch.Tensor, depth: torch.Tensor, across: torch.Tensor, down: torch.Tensor, size: int, like: dict[str, Any]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(direction [L, 3], solid angle times height [L], variance [L]) of cells of texels' tents.

    A tent is cut into 2^depth x 2^depth cells over its two texels' width. It leans towards its top: so does the centre of a
    cell's light, and its variance is less than a box's.
    """
    step = 2.0 / 2.0 ** depth.to(**like)
    axes = torch.as_tensor(AXES, **like)[(node // (size * size)).clamp(max=5)]
    half, variance, height, place = 2.0 / size, step * step / 6, torch.ones_like(step), []
    for cell, index in ((across, node % size), (down, (node // size) % size)):
        x = (cell + 0.5) * step - 1
        top = 1 - x.abs()
        lean = step * step / (12 * top.clamp_min(1e-9))
        variance, height = variance - lean * lean, height * top
        place.append((index + 0.5 + x - torch.sign(x) * lean) * half - 1)
    direction = axes[:, 0] + place[0][:, None] * axes[:, 1] + place[1][:, None] * axes[:, 2]
    length = direction.norm(dim=1)
    shrink = 1 / length**3
    angle = half * half * step * step * shrink * height
    return direction / length[:, None], angle, half * half / 2 * variance * shrink


def _weights(
    normal: torch.Tensor, view: torch.Tensor, alpha: torch.Tensor, eta: torch.Tensor, leaves: _Leaves, lobe: str
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(D G1 F d omega [L], half vectors [L, 3], v.h [L]); the light's spread about a leaf widens the lobe to second order."""
    n, v, a2, l = normal[leaves.point], view[leaves.point], alpha[leaves.point] ** 2, leaves.direction
    s = v + l
    length = s.norm(dim=1).clamp_min(1e-3)
    h, vh = s / length[:, None], length / 2
    nh, nl = (n * h).sum(1), (n * l).sum(1)
    cos2 = nh * nh
    # The value does not cancel for narrow lobes; the slope is that of 1 - cos2.
    sin2 = (torch.linalg.cross(n, h) ** 2).sum(1).detach() + (cos2.detach() - cos2)
    slopes = leaves.variance * (1 + 1 / (vh * vh)) / 8
    if lobe == "ggx":
        q = a2 * cos2 + sin2
        d = a2 / (q * q) * (1 + slopes * cos2 * (8 * sin2 - 4 * a2 * cos2) / (q * q)).clamp_min(0.5)
    else:
        wide = a2 + 2 * slopes
        d = torch.exp(-sin2 / (cos2 * wide)) / (wide * cos2 * cos2)
    shadow = microfacet.masking(nl.clamp_min(1e-4), alpha[leaves.point], lobe)
    seen = (nl > 0) & (nh > 1e-6)
    weight = d * shadow * fresnel.reflectance(vh, eta[leaves.point]) * leaves.solid_angle
    return torch.where(seen, weight, 0.0), h, vh


def plain(
    normal: torch.Tensor,
    view: torch.Tensor,
    roughness: torch.Tensor,
    eta: torch.Tensor,
    frame_x: torch.Tensor,
    frame_y: torch.Tensor,
    tree: LightTree,
    lobe: str,
    tolerance: float,
) -> tuple[torch.Tensor, torch.Tensor]:
    """(mirrored light [P, 3], its (s1, s2) with sign reversed [P, 2, 3]), both over the lobe's albedo: the definition.

    roughness [P] and eta [P] inside `limits`. Points that see nothing of their lobe mirror the texel straight ahead,
    unpolarised.
    """
    alpha = roughness * roughness
    with torch.no_grad():
        leaves = _leaves(normal.detach(), view.detach(), alpha.detach(), tree, lobe, tolerance)
    weight, h, vh = _weights(normal, view, alpha, eta, leaves, lobe)
    x, y = frame_x[leaves.point], frame_y[leaves.point]
    cos2, sin2 = surface_pattern(h, x, y)
    square = (h * x).sum(1) ** 2 + (h * y).sum(1) ** 2
    across = fresnel.specular_polarisation(vh, square, eta[leaves.point])
    light = weight[:, None] * tree.radiance[leaves.node]
    count = len(normal)

    def gathered(values: torch.Tensor) -> torch.Tensor:
        return values.new_zeros(count, *values.shape[1:]).index_add(0, leaves.point, values)

    total = gathered(weight)
    hidden = total <= limits.NOTHING
    over = torch.where(hidden, 1.0, total)[:, None]
    turned = torch.stack([gathered((k * across)[:, None] * light) / over for k in (cos2, sin2)], 1)
    straight = tree.radiance[_straight(normal, view, tree.shape.resolution)]
    return torch.where(hidden[:, None], straight, gathered(light) / over), turned


def _straight(normal: torch.Tensor, view: torch.Tensor, resolution: int) -> torch.Tensor:
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
    """`plain` as a fused kernel: float32, CPU; clamps roughness and ior itself."""
    return _Tree.apply(tree, lobe, tolerance, normal, view, roughness, ior, frame_x, frame_y, tree.radiance)


class _Tree(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, tree: LightTree, lobe: str, tolerance: float, *tensors: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        from . import light_tree_kernels as kernels

        shape = tree.shape
        arrays = [x.detach().contiguous().numpy() for x in tensors]
        table = (tree.place.contiguous().numpy(), shape.solid_angle, shape.radius, shape.child, shape.first_root)
        fixed = (*table, shape.resolution, float(tolerance), MOST_HALVINGS, lobe == "ggx")
        points = len(arrays[0])
        value, turned, total = torch.empty(points, 3), torch.empty(points, 2, 3), np.empty(points, np.float32)
        kernel: Any = kernels.forward
        kernel(*arrays, *fixed, value.numpy(), turned.numpy(), total)
        hidden = np.flatnonzero(~(total > 0))
        if len(hidden):
            ahead = _straight(tensors[0][hidden], tensors[1][hidden], shape.resolution)
            value[hidden] = tensors[6].detach()[ahead]
        ctx.arrays, ctx.fixed, ctx.sums = arrays, fixed, (value.numpy(), turned.numpy(), total)
        return value, turned

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        from . import light_tree_kernels as kernels
        from .shade_kernels import chunks

        normal, view, roughness, ior, _, _, radiance = ctx.arrays
        tables = torch.zeros(chunks(len(normal)), *radiance.shape)
        new = [torch.empty(x.shape) for x in (normal, view, roughness, ior)]
        kernel: Any = kernels.backward
        given = [g.contiguous().numpy() for g in gradients]
        kernel(*ctx.arrays, *ctx.fixed, *ctx.sums, *given, *(x.numpy() for x in new), tables.numpy())
        return (None, None, None, *new, None, None, tables.sum(0))
