"""The environment as training sees it: radiance on a cube behind an activation, and its smoothness prior over the sphere."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from pipeline.shading import cube_directions
from pipeline.shading.environment import activate, deactivate

STEP_WIDTH = 0.05  # log radiance: a step between texels past which it costs linearly
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
        if flat.device.type == "cpu" and flat.dtype == torch.float32:
            return _Steps.apply(flat, self.edges)
        return mean_step(flat, self.edges)


def mean_step(values: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
    """Mean robust difference of values [M, 3] along edges [2, E], in torch: the definition."""
    difference = values.index_select(0, edges[1]) - values.index_select(0, edges[0])
    return (torch.sqrt(difference * difference + STEP_WIDTH**2) - STEP_WIDTH).mean()


class _Steps(torch.autograd.Function):
    """`mean_step` with its gradient in one pass (numba)."""

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
        from .splats.surface_kernels import steps

        flat = values.detach().contiguous().numpy()
        gradient = np.zeros_like(flat)
        total = steps(flat, edges.numpy(), np.float32(STEP_WIDTH), gradient)
        ctx.gradient, ctx.share = torch.from_numpy(gradient), 1 / (3 * edges.shape[1])
        return torch.tensor(total * ctx.share, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        return ctx.gradient * (gradients[0] * ctx.share), None
