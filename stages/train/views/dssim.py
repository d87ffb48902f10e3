"""Structural dissimilarity, the other part of PhyGaP's L_rgb = 0.8 L1 + 0.2 DSSIM, with its gradient in closed form."""

from __future__ import annotations

from typing import Any

import torch

SIGMA, RADIUS = 1.5, 5  # the window of Wang et al. 2004: Gaussian, 11 taps
C1, C2 = 0.01**2, 0.03**2  # their constants for values in 0..1, which is what encoded radiance is, highlights aside


def blurred(images: torch.Tensor) -> torch.Tensor:
    """Gaussian means [B, H, W] of images [B, H, W], zero outside: its own adjoint."""
    x = torch.arange(-RADIUS, RADIUS + 1, dtype=images.dtype, device=images.device)
    taps = torch.exp(-0.5 * (x / SIGMA) ** 2)
    taps = taps / taps.sum()
    rows = torch.nn.functional.conv2d(images[:, None], taps[None, None, None], padding=(0, RADIUS))
    return torch.nn.functional.conv2d(rows, taps[None, None, :, None], padding=(RADIUS, 0))[:, 0]


class _Structure(torch.autograd.Function):
    """Weighted sum of 1 - SSIM over images x, y [C, H, W], weight [H, W]; the gradient goes to x alone.

    SSIM at a pixel is f(E x, E x^2, E xy), E the Gaussian mean. E is its own adjoint, so with f's partial derivatives
    a, b, c (times the weight) the gradient at a pixel is E a + 2 x E b + y E c: as many blurs as the value takes.
    """

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, y: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        count = len(x)
        mx, my, xx, yy, xy = blurred(torch.cat([x, y, x * x, y * y, x * y])).split(count)
        light, light_below = 2 * mx * my + C1, mx * mx + my * my + C1
        varied, varied_below = 2 * (xy - mx * my) + C2, xx - mx * mx + yy - my * my + C2
        first, second = light / light_below, varied / varied_below
        by_xx = -first * second / varied_below
        by_xy = 2 * first / varied_below
        by_mean = 2 * second * (my - mx * first) / light_below - my * by_xy - 2 * mx * by_xx
        ctx.save_for_backward(x, y, weight, by_mean, by_xx, by_xy)
        return ((1 - first * second) * weight).sum()

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> tuple[Any, ...]:
        x, y, weight, *partial = ctx.saved_tensors
        a, b, c = blurred(torch.cat([p * weight for p in partial])).split(len(x))
        return -gradients[0] * (a + 2 * x * b + y * c), None, None


def dssim(predicted: torch.Tensor, target: torch.Tensor, pixels: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Mean of 1 - SSIM over pixels and channels: values [P, 3] at flat indices `pixels` [P] of an image of `size` (H, W).

    What is not listed counts as equal (0 in both): a window at the edge then sees as much less of either.
    """
    width = size[1]
    row, column = pixels // width, pixels % width
    top, left = int(row.min()), int(column.min())
    shape = (int(row.max()) - top + 1, int(column.max()) - left + 1)
    index = (row - top) * shape[1] + column - left

    def image(values: torch.Tensor) -> torch.Tensor:
        out = values.new_zeros(shape[0] * shape[1], values.shape[-1]).index_copy(0, index, values)
        return out.T.reshape(-1, *shape)

    weight = image(predicted.new_full((len(pixels), 1), 1 / (3 * len(pixels))))[0]
    return _Structure.apply(image(predicted), image(target), weight)
