"""Figures of merit while training: PSNR of display-encoded radiance, as the report will judge it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from .objective import compared
from .renderer import Renderer
from .views.source_views import Mode
from .views.view import View

LEAST_EXPOSURE, MOST_EXPOSURE = 0.25, 250.0  # the mean foreground is 0.25 in the training exposure: it is past white in the
# capture's units below the first factor, and less than 1/1000 of it above the second


def srgb(linear: torch.Tensor) -> torch.Tensor:
    """Linear to sRGB, clipped to [0, 1] (IEC 61966-2-1)."""
    x = linear.clamp(0, 1)
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def psnr(predicted: torch.Tensor, target: torch.Tensor, exposure: float) -> float:
    """sRGB PSNR (dB) of radiances in the training exposure; capped at 120 (equal images).

    As the report clips them, at 1 in the capture's units; in the training exposure where that would make everything white
    (counts of a sensor, a scene in full sun) or black, and any model right.
    """
    exposure = exposure if LEAST_EXPOSURE <= exposure <= MOST_EXPOSURE else 1.0
    difference = srgb(predicted / exposure) - srgb(target / exposure)
    return -10 * math.log10(max(float((difference**2).mean()), 1e-12))


@torch.no_grad()
def validation_psnr(renderer: Renderer, views: Sequence[View], mode: Mode, exposure: float) -> float:
    """Mean `psnr` (dB) inside the masks of the validation views; of two training views where none are held back.

    NaN where no view shows anything.

    renderer: of the scene; views: at full size; mode: what they hold; exposure: training over capture radiance.
    """
    showing = [v for v in views if v.inside.any()] or [v for v in views if len(v.pixels)]
    judges = [v for v in showing if v.split == "validation"]
    judges = judges or [v for v in showing if v.split == "train"][:2]
    light = renderer.light()
    values = []
    for view in judges:
        predicted, measured = compared(mode, renderer.scene, renderer.render(view, 0, light).stokes, view)
        inside = view.inside if view.inside.any() else torch.ones_like(view.inside)  # an object nowhere two pixels wide
        values.append(psnr(predicted[inside], measured[inside], exposure))
    return sum(values) / len(values) if values else float("nan")
