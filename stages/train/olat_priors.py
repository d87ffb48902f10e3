"""What a light stage has measured of the same object, as terms of the loss: normals, albedo up to a factor, roughness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from .render_view import rasterise_view
from .splats.gaussians import Splats
from .views import losses
from .views.olat_maps import NORMAL_FLOOR, MapPixels

NORMAL, ALBEDO, ROUGHNESS = 0.5, 0.2, 0.5
"""Weights beside the radiance loss: of a unit normal's difference (a degree is 0.017), of encoded albedo, of roughness."""
NORMAL_WIDTH, ROUGHNESS_WIDTH = float(np.radians(NORMAL_FLOOR)), 0.02  # residual below which a loss is quadratic
DARKEST = 1e-3  # albedo below which its logarithm is noise


class OlatPriors:
    """The maps that a scene is compared with, one camera a step.

    The light stage's lights and the views' exposures have different units: albedos agree up to one factor a channel, the same
    for all cameras, which every step finds anew from what each camera last said.

    Args:
        cameras: at least one.
        backend: rasteriser, "cpu", "cuda" or "reference".
    """

    def __init__(self, cameras: Sequence[MapPixels], backend: str) -> None:
        self.cameras, self.backend = list(cameras), backend
        device = cameras[0].albedo.device
        self.ratios = torch.zeros(len(cameras), 4, device=device)  # sums of weight times log ratio by channel, and of weight

    def terms(self, splats: Splats, iteration: int) -> dict[str, torch.Tensor]:
        """Weighted losses by name: the scene against the camera whose turn it is.

        Args:
            splats: the scene's, whose gradients follow.
            iteration: step of the run.
        """
        turn = iteration % len(self.cameras)
        maps = self.cameras[turn]
        seen = rasterise_view(splats, maps.view, maps.view.pixels, self.backend)
        opaque = seen.alpha.detach()
        normal = (seen.normal - maps.normal).square().sum(-1)
        far = torch.sqrt(normal + NORMAL_WIDTH**2) - NORMAL_WIDTH
        weight = opaque * maps.albedo_weight
        factor = self._factor(turn, seen.albedo.detach(), maps.albedo, weight)
        unlike = losses.robust(losses.encode(seen.albedo) - losses.encode(factor * maps.albedo)).mean(-1)
        rougher = losses.robust(seen.roughness - maps.roughness, ROUGHNESS_WIDTH)
        return {
            "olat_normal": NORMAL * losses.weighted_mean(far, opaque * maps.normal_weight),
            "olat_albedo": ALBEDO * losses.weighted_mean(unlike, weight),
            "olat_roughness": ROUGHNESS * losses.weighted_mean(rougher, opaque * maps.roughness_weight),
        }

    @torch.no_grad()
    def _factor(self, turn: int, rendered: torch.Tensor, measured: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """Rendered over measured albedo by channel [3]: the geometric mean over all cameras' pixels."""
        ratio = torch.log(rendered.clamp_min(DARKEST)) - torch.log(measured.clamp_min(DARKEST))
        bright = weight * (measured > DARKEST).all(-1)
        self.ratios[turn, :3], self.ratios[turn, 3] = (bright[:, None] * ratio).sum(0), bright.sum()
        total = self.ratios.sum(0)
        return torch.exp(total[:3] / total[3].clamp_min(1e-9))

    def state(self) -> torch.Tensor:
        """What the next step depends on."""
        return self.ratios.clone()

    def load(self, state: torch.Tensor) -> None:
        """Continue from a saved state."""
        self.ratios.copy_(state)
