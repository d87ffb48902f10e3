"""The learnable environment: a cube of radiance behind PhyGaP's activation."""

from __future__ import annotations

import torch

# Radiance of an untouched environment (raw 0): what Eq. 33 gives there.
GREY = 0.5


def activate(raw: torch.Tensor) -> torch.Tensor:
    """Turn raw values into radiance: sigmoid(x) for x <= 0, x + 0.5 above; slope 1/4 to 1 over 0 (PhyGaP Eq. 33).

    Args:
        raw: any real numbers. [...]

    Returns:
        Radiance > 0. [...]
    """
    return torch.where(raw > 0, raw + GREY, torch.sigmoid(raw))


def deactivate(radiance: torch.Tensor) -> torch.Tensor:
    """Invert `activate`.

    Args:
        radiance: raised to 1e-6 (raw -13.8, where the sigmoid's slope dies). [...]

    Returns:
        Raw values. [...]
    """
    low = radiance.clamp(1e-6, GREY)
    return torch.where(radiance > GREY, radiance - GREY, torch.log(low) - torch.log1p(-low))


class EnvironmentCube(torch.nn.Module):
    """Learnable radiance [6, R, R, 3] on a cube (linear RGB), `raw` before the activation."""

    def __init__(self, resolution: int = 32, radiance: float | torch.Tensor = GREY) -> None:
        super().__init__()
        self.resolution = resolution
        start = torch.as_tensor(radiance, dtype=torch.float32).expand(6, resolution, resolution, 3)
        self.raw = torch.nn.Parameter(deactivate(start).contiguous())

    def radiance(self) -> torch.Tensor:
        """Linear radiance [6, R, R, 3], all positive."""
        return activate(self.raw)
