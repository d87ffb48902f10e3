"""More Gaussians where the images ask for them, fewer where nothing shows: pure operations on model and optimiser."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from .gaussians import SplatModel
from .optimiser import SurfaceAdam
from .surface_graph import SurfaceGraph

LEAST_OPACITY = 0.05  # fainter splats are removed (the released code's figure)
SHRINK = 0.85  # scale of a split edge's ends and of the new splat, so that details get sharper and coverage stays
GROWTH = 0.08  # largest share of new splats a time


@dataclass
class Activity:
    """Per splat since the last look: summed screen gradient (1/px), and times drawn. [N] each."""

    gradient: torch.Tensor
    drawn: torch.Tensor

    @classmethod
    def empty(cls, count: int, device: torch.device | str) -> Activity:
        """Nothing seen yet."""
        return cls(*(torch.zeros(count, device=device) for _ in range(2)))

    def add(self, rows: torch.Tensor, gradient: torch.Tensor, weight: torch.Tensor) -> None:
        """Take in one view: values of the splats `rows` that were drawn."""
        if weight.device.type == "cpu":
            from .splat_kernels import count_view

            count_view(*(t.numpy() for t in (rows, gradient, weight, self.gradient, self.drawn)))
            return
        self.gradient[rows] += gradient
        self.drawn[rows] += (weight > 0).to(self.drawn.dtype)

    def rows(self, rows: torch.Tensor) -> Activity:
        """That of these splats alone."""
        return Activity(self.gradient[rows], self.drawn[rows])


def kept_rows(opacities: torch.Tensor) -> torch.Tensor:
    """Indices of the splats that are opaque enough to show.

    What other splats hide from every training view stays: another view may see it, and a hole in its place. (A view held back
    of a vase lacked an eighth of its pixels, those of the underside, where hidden splats went.)
    """
    return torch.nonzero(opacities > LEAST_OPACITY)[:, 0]


def edges_to_split(graph: SurfaceGraph, activity: Activity, most: int) -> torch.Tensor:
    """Up to `most` edges [2, M] about which the images pull hardest, none sharing a splat."""
    count = len(activity.gradient)
    most = min(most, int(GROWTH * count))
    if most <= 0 or graph.edges.shape[1] == 0:
        return graph.edges[:, :0]
    pull = activity.gradient / activity.drawn.clamp_min(1)
    i, j = graph.edges
    score = torch.minimum(pull[i], pull[j])
    order = torch.argsort(score, descending=True, stable=True)[: 8 * most].cpu().tolist()
    first, second = i.cpu().tolist(), j.cpu().tolist()
    used: set[int] = set()
    chosen: list[int] = []
    for e in order:
        if len(chosen) == most:
            break
        if first[e] not in used and second[e] not in used:
            used.update((first[e], second[e]))
            chosen.append(e)
    return graph.edges[:, torch.tensor(chosen, dtype=torch.long, device=graph.edges.device)]


@torch.no_grad()
def split_edges(model: SplatModel, adam: SurfaceAdam, edges: torch.Tensor) -> None:
    """Add a splat at every edge's middle with its ends' mean values, in place; all three shrink."""
    i, j = edges
    if len(i) == 0:
        return
    for name in model.per_splat:
        old = model.tensors[name].detach().clone()
        if name == "log_scale":
            old[edges.reshape(-1)] += torch.log(torch.tensor(SHRINK)).item()
        model.tensors[name] = torch.cat([old, 0.5 * (old[i] + old[j])]).requires_grad_(True)
    adam.append(model.per_splat, len(i))


@torch.no_grad()
def keep(model: SplatModel, adam: SurfaceAdam, rows: torch.Tensor) -> None:
    """Remove every splat but these, in place."""
    model.select(rows)
    adam.select(model.per_splat, rows)
