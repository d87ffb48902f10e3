"""Figures of merit while training: PSNR of display-encoded radiance, as the report will judge it."""

from __future__ import annotations

import math

import torch

LEAST_EXPOSURE = 0.25  # the mean foreground is 0.25 in the training exposure: below this factor it is past white outside


def srgb(linear: torch.Tensor) -> torch.Tensor:
    """Linear to sRGB, clipped to [0, 1] (IEC 61966-2-1)."""
    x = linear.clamp(0, 1)
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def psnr(predicted: torch.Tensor, target: torch.Tensor, exposure: float) -> float:
    """sRGB PSNR (dB) of radiances in the training exposure; capped at 120 (equal images).

    As the report clips them, at 1 in the capture's units; in the training exposure where their mean is past that (counts
    of a sensor, a scene in full sun), or everything would be white and any model right.
    """
    exposure = 1.0 if exposure < LEAST_EXPOSURE else exposure
    difference = srgb(predicted / exposure) - srgb(target / exposure)
    return -10 * math.log10(max(float((difference**2).mean()), 1e-12))
