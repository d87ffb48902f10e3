"""What shading takes and gives."""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Shaded:
    """Radiance leaving P points towards the camera, linear RGB.

    Fields:
        stokes: s0, s1, s2 by R, G, B. [P, 3, 3]
        diffuse, specular: their sum is s0. [P, 3]
    """

    stokes: torch.Tensor
    diffuse: torch.Tensor
    specular: torch.Tensor


@dataclass(frozen=True)
class Occlusion:
    """What the object itself takes from and adds to the light at P points; see `transfer` and `gridmap`.

    irradiance' = shadow * irradiance + bounced, mirrored' = unblocked * mirrored + seen.
    """

    shadow: torch.Tensor  # [P, 3] share of the unoccluded irradiance that arrives
    bounced: torch.Tensor  # [P, 3] irradiance from the object's own surface (radiance units times sr)
    unblocked: torch.Tensor  # [P] share of the mirrored lobe that leaves the object
    seen: torch.Tensor  # [P, 3] radiance of the object's own surface in the rest of it


def clamp_keeping_gradient(x: torch.Tensor, low: float, high: float) -> torch.Tensor:
    """x limited to [low, high]; the gradient passes as if it were not, so that a value outside finds back."""
    return x + (x.clamp(low, high) - x).detach()
