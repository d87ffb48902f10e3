"""Steps along the direction that light and albedo share: a brighter environment and a darker object look nearly the same.

Only reflections tell them apart (per colour channel), so the loss is flat along it and every texel's and splat's own
steps leave it where the start had put it. One common step for each channel, with moments of its own, sees the sum of all
their gradients.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from .optimiser import adam_update

RATE = 1e-2  # log units a step at most: a start wrong by a factor of two is mended within a hundred steps
MOST_ALBEDO = 0.9  # nearer to 1 a sigmoid hardly moves: its share of the step stops growing there


class ScaleStep:
    """Adam on g [3], where log environment += g and log albedo -= g. `moments` [2, 3]; `steps` so far."""

    def __init__(self) -> None:
        self.moments: torch.Tensor | None = None
        self.steps = 0

    @torch.no_grad()
    def step(self, environment: torch.Tensor, albedo: torch.Tensor, rate_scale: float) -> None:
        """Move log radiance [..., 3] and albedo logits [N, 3] in place; call it while their gradients are still there."""
        if environment.grad is None or albedo.grad is None:
            return
        share, pull = albedo_pull(albedo)
        gradient = environment.grad.reshape(-1, 3).sum(0) - pull
        gradient = torch.nan_to_num(gradient, nan=0.0, posinf=0.0, neginf=0.0)
        if self.moments is None:
            self.moments = torch.zeros(2, 3, device=gradient.device)
        self.steps += 1
        first, second = self.moments
        g = -RATE * rate_scale * adam_update(first, second, gradient, self.steps)
        environment.add_(g)
        albedo.addcmul_(share, g, value=-1)

    def state(self) -> dict[str, Any]:
        """Everything a resume needs."""
        return {"moments": None if self.moments is None else self.moments.clone(), "steps": self.steps}

    def load(self, state: dict[str, Any]) -> None:
        """Take over a saved state."""
        self.moments, self.steps = state["moments"], state["steps"]


def albedo_pull(albedo: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Of logits [N, 3] with a gradient: d logit = share * d log albedo [N, 3], and the gradient along it, summed [3]."""
    gradient = albedo.grad
    assert gradient is not None
    if not (albedo.device.type == "cpu" and albedo.dtype == torch.float32 and albedo.is_contiguous()):
        return albedo_pull_plainly(albedo, gradient)
    from .splat_kernels import scale_gradient

    share, pull = torch.empty_like(albedo), np.zeros(3)
    given = (albedo.detach().numpy(), gradient.contiguous().numpy())
    scale_gradient(*given, np.float32(MOST_ALBEDO), share.numpy(), pull)
    return share, torch.as_tensor(pull, dtype=torch.float32)


def albedo_pull_plainly(albedo: torch.Tensor, gradient: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """`albedo_pull` in torch: the definition."""
    share = 1 / (1 - torch.sigmoid(albedo).clamp_max(MOST_ALBEDO))
    return share, (share * gradient).sum(0)
