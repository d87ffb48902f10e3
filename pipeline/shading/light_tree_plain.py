"""Mirrored light over the tree of light in readable torch: the definition that `light_tree_kernels` is held to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from pipeline.optics import fresnel, microfacet
from pipeline.optics.stokes import surface_pattern

from . import limits
from .cube import AXES
from .light_tree import MOST_HALVINGS, LightTree, straight_ahead


@dataclass(frozen=True)
class Leaves:
    """What the lobes of many points are summed over: L leaves."""

    point: torch.Tensor  # [L]
    node: torch.Tensor  # [L] whose radiance arrives
    direction: torch.Tensor  # [L, 3] unit, towards the light
    solid_angle: torch.Tensor  # [L]
    variance: torch.Tensor  # [L] of the light's direction along either axis (square radians)


def _leaves(
    normal: torch.Tensor, view: torch.Tensor, alpha: torch.Tensor, tree: LightTree, lobe: str, tolerance: float
) -> Leaves:
    """Go down the tree for all points at once, one level after the other."""
    shape = tree.shape
    like: dict[str, Any] = {"dtype": normal.dtype, "device": normal.device}
    angles, radii = (torch.as_tensor(x, **like) for x in (shape.solid_angle, shape.radius))
    child = torch.as_tensor(shape.child, device=normal.device).long()
    place = tree.place.to(**like)
    points = torch.nonzero(((normal * view).sum(1) > limits.AWAY) & alpha.isfinite())[:, 0]
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
    return Leaves(*(torch.cat(parts) for parts in zip(*found)))


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


def lobe_weights(
    normal: torch.Tensor, view: torch.Tensor, alpha: torch.Tensor, eta: torch.Tensor, leaves: Leaves, lobe: str
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
    weight, h, vh = lobe_weights(normal, view, alpha, eta, leaves, lobe)
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
    straight = tree.radiance[straight_ahead(normal, view, tree.shape.resolution)]
    return torch.where(hidden[:, None], straight, gathered(light) / over), turned
