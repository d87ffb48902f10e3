"""Adam over named tensors, with updates of per-splat tensors diffused along the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from .surface_graph import SurfaceGraph

BETA1, BETA2 = 0.9, 0.99  # a short run: 0.999 would still remember the first third at its end
EPSILON = 1e-12  # gradients here are means over pixels and splats, often 1e-8: a usual 1e-8 would stop the quiet ones


def adam_update(
    first: torch.Tensor, second: torch.Tensor, gradient: torch.Tensor, steps: int, together: bool = False
) -> torch.Tensor:
    """Adam's step for a unit learning rate (Kingma and Ba 2015, Alg. 1); updates both moments in place.

    first, second: moments, shaped like the gradient. `steps` counts this one. `together`: rows share one step length,
    which keeps the direction of vectors.
    """
    first.lerp_(gradient, 1 - BETA1)
    second.mul_(BETA2).addcmul_(gradient, gradient, value=1 - BETA2)
    scale = second / (1 - BETA2**steps)
    if together:
        scale = scale.mean(-1, keepdim=True)
    return first / (1 - BETA1**steps) / (scale.sqrt() + EPSILON)


def _update(first: torch.Tensor, second: torch.Tensor, gradient: torch.Tensor, steps: int, together: bool) -> torch.Tensor:
    """`adam_update`, where what is not finite in the gradient counts as 0; in one pass on the CPU."""
    moments = (first, second, gradient)
    if not all(t.device.type == "cpu" and t.dtype == torch.float32 and t.is_contiguous() for t in moments):
        return adam_update(first, second, torch.nan_to_num(gradient, nan=0.0, posinf=0.0, neginf=0.0), steps, together)
    from .splat_kernels import adam_rows

    shape = (-1, gradient.shape[-1]) if together else (-1, 1)
    update = torch.empty_like(gradient)
    factors = np.array((BETA1, BETA2, 1 - BETA1**steps, 1 - BETA2**steps, EPSILON), np.float32)
    rows = [t.detach().view(shape).numpy() for t in (gradient, *moments[:2], update)]
    adam_rows(rows[0], rows[1], rows[2], *factors, together, rows[3])
    return update


@dataclass(frozen=True)
class StepRule:
    """How one tensor is stepped: base learning rate, and diffusion rounds of its update over the surface graph."""

    rate: float
    diffusion: int = 0


class SurfaceAdam:
    """Adam whose per-splat updates are averaged with the neighbours' before they are applied.

    That is a preconditioner (the 'large steps' of Nicolet et al. 2021 in a few Jacobi rounds): it lets a surface move as
    one piece where its splats agree and is symmetric positive up to row scaling, so it does not change where the
    gradient vanishes.
    """

    def __init__(self, rules: dict[str, StepRule]) -> None:
        self.rules = rules
        self.first: dict[str, torch.Tensor] = {}
        self.second: dict[str, torch.Tensor] = {}
        self.steps: dict[str, int] = {}
        self.not_finite: dict[str, torch.Tensor] = {}
        """By tensor, int64 [2]: how many entries of its gradients were not finite, and the first step that had one."""

    @torch.no_grad()
    def step(
        self,
        tensors: dict[str, torch.Tensor],
        rate_scale: dict[str, float],
        graph: SurfaceGraph | None,
        diffusion_scale: float = 1.0,
    ) -> None:
        """One update of every tensor that has a gradient, in place; gradients are cleared.

        Args:
            tensors: by name of its rule; a non-finite gradient entry counts as 0, and in `not_finite`.
            rate_scale: factor of each rule's rate by name, "" for the others.
            graph: over which updates of per-splat tensors are diffused; None: they are not.
            diffusion_scale: factor of the rules' diffusion rounds.
        """
        for name, tensor in tensors.items():
            if tensor.grad is None or name not in self.rules:
                continue
            rule = self.rules[name]
            gradient, tensor.grad = tensor.grad, None
            lost = (~torch.isfinite(gradient)).sum()  # stays on the device: nothing waits for it
            if name not in self.first or self.first[name].shape != tensor.shape:
                self.first[name] = torch.zeros_like(tensor)
                self.second[name] = torch.zeros_like(tensor)
                self.steps[name] = 0
            self.steps[name] += 1
            count, since = self.not_finite.get(name, lost.new_zeros(2))
            first = torch.where((count == 0) & (lost > 0), self.steps[name], since)
            self.not_finite[name] = torch.stack((count + lost, first))
            together = bool(rule.diffusion) and gradient.ndim > 1
            update = _update(self.first[name], self.second[name], gradient, self.steps[name], together)
            rounds = round(rule.diffusion * diffusion_scale)
            if rounds and graph is not None and update.shape[0] == len(graph):
                flat = update.reshape(len(update), -1)
                update = graph.diffuse(flat, rounds).reshape(update.shape)
            tensor.sub_(update, alpha=rule.rate * rate_scale.get(name, rate_scale[""]))

    def select(self, names: tuple[str, ...], rows: torch.Tensor) -> None:
        """Keep these rows of the moments of per-splat tensors (the same rows that the model keeps)."""
        for name in names:
            if name in self.first:
                self.first[name] = self.first[name][rows].clone()
                self.second[name] = self.second[name][rows].clone()

    def append(self, names: tuple[str, ...], count: int) -> None:
        """Moments of `count` new rows: none yet."""
        for name in names:
            for moments in (self.first, self.second):
                if name in moments:
                    old = moments[name]
                    moments[name] = torch.cat([old, old.new_zeros(count, *old.shape[1:])])

    def state(self) -> dict[str, Any]:
        """Everything a resume needs."""
        return {"first": self.first, "second": self.second, "steps": self.steps, "not_finite": self.not_finite}

    def load(self, state: dict[str, Any]) -> None:
        """Take over a saved state."""
        self.first, self.second, self.steps = state["first"], state["second"], dict(state["steps"])
        self.not_finite = dict(state.get("not_finite", {}))
