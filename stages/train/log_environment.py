"""The environment as training sees it: radiance on a cube behind an activation, and its smoothness prior over the sphere."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from pipeline.shading import cube_directions
from pipeline.shading.environment import activate, deactivate

DARKEST = 1e-4  # radiance (training exposure) below which a texel is black for every purpose: bounds the logarithm


class Environment:
    """Raw values [6, R, R, 3] and the texel graph (4 to 8 neighbours across all face borders).

    activation: "exponential" (raw is log radiance) or "printed" (PhyGaP Eq. 33).
    """

    def __init__(self, resolution: int, radiance: float, device: str = "cpu", activation: str = "exponential") -> None:
        self.resolution, self.activation = resolution, activation
        start = torch.full((6, resolution, resolution, 3), radiance, device=device)
        self.raw = (torch.log(start) if activation == "exponential" else deactivate(start)).requires_grad_(True)
        directions = cube_directions(resolution).reshape(-1, 3)
        _, index = cKDTree(directions).query(directions, k=5)
        i = np.repeat(np.arange(len(directions)), 4)
        pairs = np.unique(np.sort(np.stack([i, index[:, 1:].ravel()], -1), -1), axis=0)
        self.edges = torch.as_tensor(pairs.T.copy(), device=device)

    def radiance(self) -> torch.Tensor:
        """Linear radiance [6, R, R, 3] > 0 in the training exposure."""
        if self.activation == "printed":
            return activate(self.raw)
        return torch.exp(self.raw.clamp(np.log(DARKEST), 30.0))  # e^30: past any sun, within float32

    def roughness_of(self) -> torch.Tensor:
        """Smoothness prior: mean robust difference of log radiance between neighbouring texels (halos may be steep)."""
        flat = (self.raw if self.activation == "exponential" else torch.log(activate(self.raw))).reshape(-1, 3)
        # Not flat[edges]: its gradient adds with atomics where OpenMP has two threads (numba's pool gives them back to torch),
        # in an order that differs from run to run.
        difference = flat.index_select(0, self.edges[1]) - flat.index_select(0, self.edges[0])
        return (torch.sqrt(difference * difference + 0.05**2) - 0.05).mean()
