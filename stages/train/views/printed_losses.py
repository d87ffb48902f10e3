"""The losses of PhyGaP Eq. 10 as printed (4.3): on linear radiance, images compared pixel by pixel, normals as an image.

Sums over the frame, over the counting pixels' number: the frame's means, but for a factor that all of them share.
"""

from __future__ import annotations

import torch

from .dssim import dssim
from .view import View

SOLID = 0.5  # opacity from which a pixel shows a surface whose depth means something


def rgb_loss(predicted: torch.Tensor, target: torch.Tensor, view: View) -> tuple[torch.Tensor, torch.Tensor]:
    """(L1, DSSIM) of s0; predicted, target [P, 3], linear, in the training exposure."""
    absolute = ((predicted - target).abs().mean(-1) * view.colour_weight).mean()
    return absolute, dssim(predicted, target, view.pixels, view.size)


def polarisation_loss(predicted: torch.Tensor, target: torch.Tensor, view: View) -> torch.Tensor:
    """L1(s1) + L1(s2); predicted, target [P, 3, 3]."""
    return ((predicted[:, 1:] - target[:, 1:]).abs().mean(-1).sum(-1) * view.colour_weight).mean()


def mask_loss(alpha_image: torch.Tensor, view: View) -> torch.Tensor:
    """L1 of the mask and the opacity [H, W]."""
    return ((alpha_image - view.alpha_target).abs() * view.alpha_weight).sum() / max(len(view.pixels), 1)


def depth_normal_loss(normal: torch.Tensor, depth: torch.Tensor, alpha: torch.Tensor, view: View) -> torch.Tensor:
    """1 - n.n', n' the normal of the surface of the depths about a pixel.

    normal [P, 3]: blended, unit; depth [P]: camera z over opacity; alpha [P]. Pixels on a rim, whose neighbours show no
    surface, do not count.
    """
    solid = alpha.detach() > SOLID
    points = view.points_at(depth)
    left, right, up, down = (neighbours(view, step) for step in (-1, 1, -view.size[1], view.size[1]))
    whole = solid.clone()
    for rows in (left, right, up, down):
        whole &= (rows >= 0) & solid[rows.clamp_min(0)]
    if not whole.any():
        return normal.sum() * 0
    along = points[right[whole]] - points[left[whole]]
    across = points[down[whole]] - points[up[whole]]
    found = torch.nn.functional.normalize(torch.linalg.cross(across, along), dim=-1, eps=1e-12)  # right x down points away
    return (1 - (found * normal[whole]).sum(-1)).sum() / len(normal)


def smooth_loss(normal: torch.Tensor, target: torch.Tensor, view: View) -> torch.Tensor:
    """|grad n| exp(-|grad s0|) by forward differences; normal [P, 3], target [P, 3] (the photograph's s0)."""
    right, down = neighbours(view, 1), neighbours(view, view.size[1])
    both = (right >= 0) & (down >= 0)
    if not both.any():
        return normal.sum() * 0

    def gradient(values: torch.Tensor) -> torch.Tensor:
        here = values[both]
        steps = torch.cat([values[right[both]] - here, values[down[both]] - here], -1)
        return (steps.square().sum(-1) + 1e-12).sqrt()  # a flat place has no direction

    return (gradient(normal) * torch.exp(-gradient(target.mean(-1, keepdim=True)))).sum() / len(normal)


def neighbours(view: View, step: int) -> torch.Tensor:
    """Rows [P] of the counting pixels `step` further on in the flat image; -1 where that is none, or lies in another line."""
    height, width = view.size
    row_of = torch.full((height * width,), -1, dtype=torch.long, device=view.pixels.device)
    row_of[view.pixels] = torch.arange(len(view.pixels), device=view.pixels.device)
    place = view.pixels + step
    inside = (place >= 0) & (place < height * width)
    if abs(step) == 1:
        inside &= place // width == view.pixels // width
    return torch.where(inside, row_of[place.clamp(0, height * width - 1)], -1)
