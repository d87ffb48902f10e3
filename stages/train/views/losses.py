"""The five losses of PhyGaP Eq. 10, as unreduced maps or means, in forms that suit short float32 optimisation.

Radiance is compared after a display-like encoding, so that a highlight a hundred times brighter than the rest does not
own the fit; the Stokes parts are weighted by the slope of that same encoding, i.e. as contrast.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

GAMMA = 1 / 2.4  # sRGB's exponent
TOE = 0.005  # keeps the encoding's slope finite at black: 9 there, sRGB's is 12.9 (unit: mean foreground = 0.25)
CHARBONNIER = 0.01  # encoded residual below which the loss is quadratic: about one 8-bit step and a half


def encode(x: torch.Tensor) -> torch.Tensor:
    """Display-like encoding of radiance: (x + toe)^(1/2.4) - toe^(1/2.4), continued linearly below 0."""
    up = x.clamp_min(0)
    slope = GAMMA * TOE ** (GAMMA - 1)
    return (up + TOE) ** GAMMA - TOE**GAMMA + slope * (x - up)


def encode_slope(x: torch.Tensor) -> torch.Tensor:
    """Derivative of `encode` at x >= 0 (at 0 below)."""
    return GAMMA * (x.clamp_min(0) + TOE) ** (GAMMA - 1)


def robust(residual: torch.Tensor, width: float = CHARBONNIER) -> torch.Tensor:
    """Charbonnier penalty: quadratic below `width`, then linear with slope 1."""
    return torch.sqrt(residual * residual + width * width) - width


def radiance_loss(predicted: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """L_rgb: weighted mean of the robust encoded difference; predicted, target [P, 3], weight [P]."""
    target = _known(target, weight)
    if _fused(predicted, target, weight):
        return _PixelLoss.apply("radiance_terms", predicted, target, weight)
    return radiance_loss_plainly(predicted, target, weight)


def radiance_loss_plainly(predicted: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """`radiance_loss` in torch: the definition."""
    return weighted_mean(robust(encode(predicted) - encode(target)).mean(-1), weight)


def stokes_loss(predicted: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """L_pol for full Stokes data: s1 and s2 in units of encoded radiance; predicted, target [P, 3, 3], weight [P]."""
    target = _known(target, weight)
    if _fused(predicted, target, weight):
        return _PixelLoss.apply("stokes_terms", predicted, target, weight)
    return stokes_loss_plainly(predicted, target, weight)


def stokes_loss_plainly(predicted: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """`stokes_loss` in torch: the definition."""
    slope = encode_slope(target[:, :1])
    return weighted_mean(robust(slope * (predicted[:, 1:] - target[:, 1:])).mean((-1, -2)), weight)


def weighted_mean(values: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Sum of weight * value over the sum of weights; 0 for no weight. What has no weight may be NaN or infinite."""
    return (torch.where(weight > 0, values, 0.0) * weight).sum() / weight.sum().clamp_min(1e-12)


def _known(target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """The target [P, ...] with 0 where it has no weight: a NaN there would reach the gradient as 0 times NaN."""
    return torch.where(weight.reshape(-1, *[1] * (target.ndim - 1)) > 0, target, 0.0)


def mask_loss(alpha: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """L_mask: mean absolute difference of alpha and target [H, W], times weight [H, W].

    Relative to the object's area, so that empty margins do not dilute it.
    """
    if _fused(alpha, target, weight):
        return _CoverageLoss.apply(alpha, target, weight)
    return mask_loss_plainly(alpha, target, weight)


def mask_loss_plainly(alpha: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """`mask_loss` in torch: the definition."""
    return ((alpha - target).abs() * weight).sum() / target.sum().clamp_min(1.0)


def _fused(predicted: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> bool:
    """Whether one pass of a kernel (numba, float32, CPU) gives a loss and its gradient in `predicted`, the only one wanted."""
    tensors = (predicted, target, weight)
    plain = all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors)
    return plain and not (target.requires_grad or weight.requires_grad)


class _PixelLoss(torch.autograd.Function):
    """A weighted mean over pixels whose kernel (of `pixel_kernels`) gives the sum and the gradient together."""

    @staticmethod
    def forward(ctx: Any, name: str, predicted: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        from .. import pixel_kernels

        arrays = [t.detach().contiguous().numpy() for t in (predicted, target, weight)]
        gradient = np.empty_like(arrays[0])
        total = getattr(pixel_kernels, name)(*arrays, *np.array((TOE, GAMMA, CHARBONNIER), np.float32), gradient)
        share = 1 / max(float(arrays[2].sum(dtype=np.float64)), 1e-12)
        ctx.gradient, ctx.share = torch.from_numpy(gradient), share
        return torch.tensor(total * share, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[None, torch.Tensor, None, None]:
        return None, ctx.gradient * (gradients[0] * ctx.share), None, None


class _CoverageLoss(torch.autograd.Function):
    """`mask_loss` with its gradient in alpha in one pass."""

    @staticmethod
    def forward(ctx: Any, alpha: torch.Tensor, target: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        from ..pixel_kernels import coverage_terms

        arrays = [t.detach().contiguous().numpy().ravel() for t in (alpha, target, weight)]
        gradient = np.empty_like(arrays[0])
        total, area = coverage_terms(*arrays, gradient)
        ctx.gradient, ctx.share = torch.from_numpy(gradient.reshape(alpha.shape)), 1 / max(area, 1.0)
        return torch.tensor(total * ctx.share, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        return ctx.gradient * (gradients[0] * ctx.share), None, None
