"""Attributes of a view's counting pixels out of a raster, in one pass on the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from .splats.gaussians import unit

LEAST_ALPHA = 1e-3  # opacity below which a pixel's attributes are noise over noise: they then fade to zero instead

Attributes = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


def pixel_attributes(features: torch.Tensor, alpha: torch.Tensor, pixels: torch.Tensor) -> Attributes:
    """Blended features divided by opacity.

    Args:
        features: sums of weight times normal, albedo, roughness, IoR and C more. [H, W, 8 + C]
        alpha: sums of weights. [H, W]
        pixels: flat indices, each once. [P]

    Returns:
        normal [P, 3] (unit), albedo [P, 3], roughness, ior [P], more [P, C], alpha [P].
    """
    if features.device.type == "cpu" and features.dtype == torch.float32:
        return _PixelAttributes.apply(features, alpha, pixels)
    return pixel_attributes_plainly(features, alpha, pixels)


def pixel_attributes_plainly(features: torch.Tensor, alpha: torch.Tensor, pixels: torch.Tensor) -> Attributes:
    """`pixel_attributes` in torch: the definition."""
    alpha = alpha.reshape(-1)[pixels]
    values = features.reshape(-1, features.shape[-1])[pixels] / alpha.clamp_min(LEAST_ALPHA)[:, None]
    return unit(values[:, :3]), values[:, 3:6], values[:, 6], values[:, 7], values[:, 8:], alpha


class _PixelAttributes(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: torch.Tensor, alpha: torch.Tensor, pixels: torch.Tensor) -> Any:
        from .pixel_kernels import divide

        count, more = len(pixels), features.shape[-1] - 8
        image, opacity, index = (t.detach().contiguous().numpy() for t in (features, alpha, pixels))
        image, opacity = image.reshape(-1, features.shape[-1]), opacity.reshape(-1)
        out = tuple(np.empty((count, *shape), np.float32) for shape in ((3,), (3,), (), (), (more,), ()))
        length = np.empty(count, np.float32)
        divide(image, opacity, index, np.float32(LEAST_ALPHA), length, out)
        ctx.index, ctx.out, ctx.length, ctx.shape = index, out, length, features.shape
        return tuple(torch.from_numpy(a) for a in out)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, None]:
        from .pixel_kernels import divide_slopes

        given = tuple(g.contiguous().numpy() for g in gradients)
        height, width, channels = ctx.shape
        features, alpha = np.zeros((height * width, channels), np.float32), np.zeros(height * width, np.float32)
        divide_slopes(ctx.index, np.float32(LEAST_ALPHA), ctx.length, ctx.out, given, features, alpha)
        return torch.from_numpy(features.reshape(ctx.shape)), torch.from_numpy(alpha.reshape(height, width)), None
