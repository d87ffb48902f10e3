"""The losses that live on the surface: depth-normal agreement and the three smoothness terms of Eq. 10."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..views.losses import robust
from .surface_graph import SurfaceGraph, edge_difference, slope_residual

SLOPE_WIDTH = 0.05  # rad: disagreement of chord and normals below which the loss is quadratic
CREASE_WIDTH = 0.1  # rad: a turn between neighbours past this costs linearly, so that creases may stay
ALBEDO_WIDTH = 0.02  # albedo step past which a texture's outline costs linearly


@dataclass(frozen=True)
class SurfaceWeights:
    """Factors of the mean slope disagreement, normal turn, albedo variation, offset differences and offset size."""

    slope: float
    turn: float
    albedo: float
    offset_difference: float
    offset_size: float


def surface_terms(
    graph: SurfaceGraph, positions: torch.Tensor, normals: torch.Tensor, albedo: torch.Tensor, offsets: torch.Tensor
) -> torch.Tensor:
    """The five unweighted means [5]: the readable definition, used wherever the fused kernel is not.

    positions, normals (unit), albedo [N, 3]; offsets [N, 2] of roughness and IoR (raw units).
    """
    turn = edge_difference(graph, normals)
    step = edge_difference(graph, albedo)
    return torch.stack(
        [
            robust(slope_residual(graph, positions, normals), SLOPE_WIDTH).mean(),
            (torch.sqrt((turn * turn).sum(-1) + CREASE_WIDTH**2) - CREASE_WIDTH).mean(),
            (torch.sqrt((step * step).sum(-1) + ALBEDO_WIDTH**2) - ALBEDO_WIDTH).mean(),
            (edge_difference(graph, offsets) ** 2).sum(-1).mean(),
            (offsets**2).sum(-1).mean(),
        ]
    )


def surface_loss(
    graph: SurfaceGraph,
    positions: torch.Tensor,
    normals: torch.Tensor,
    albedo: torch.Tensor,
    offsets: torch.Tensor,
    weights: SurfaceWeights,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The losses on the surface, by a fused kernel on the CPU.

    Args:
        graph: neighbours among N splats.
        positions, normals, albedo: normals are unit. [N, 3]
        offsets: of roughness and IoR, raw units. [N, 2]
        weights: factors of the five `surface_terms`.

    Returns:
        Weighted total (differentiable) and the five weighted parts [5] (not).
    """
    if graph.edges.shape[1] == 0:
        zero = positions.sum() * 0
        return zero, zero.detach().expand(5)
    if positions.device.type == "cpu":
        total, parts = _FusedSurfaceLoss.apply(graph, positions, normals, albedo, offsets, weights)
        return total, parts
    factors = positions.new_tensor(
        [weights.slope, weights.turn, weights.albedo, weights.offset_difference, weights.offset_size]
    )
    parts = factors * surface_terms(graph, positions, normals, albedo, offsets)
    return parts.sum(), parts.detach()


class _FusedSurfaceLoss(torch.autograd.Function):
    """`surface_terms` times weights with its gradient in one pass over the graph (numba)."""

    @staticmethod
    def forward(ctx: Any, graph: SurfaceGraph, *arguments: Any) -> tuple[torch.Tensor, torch.Tensor]:
        from .surface_kernels import PARTS, surface_losses_rows

        *tensors, weights = arguments
        arrays = [np.ascontiguousarray(t.detach().numpy(), np.float32) for t in tensors]
        edges, rows = graph.edges.shape[1], len(graph)
        factors = np.array(
            [weights.slope, weights.turn, weights.albedo, weights.offset_difference, weights.offset_size], np.float64
        )
        factors /= np.array([edges, edges, edges, edges, rows])
        widths = np.array([SLOPE_WIDTH, CREASE_WIDTH, ALBEDO_WIDTH], np.float32)
        sums = np.zeros(PARTS)
        gradients = [np.empty_like(a) for a in arrays]
        links = graph.indptr.numpy(), graph.indices.numpy()
        arguments = (0, rows, *links, *arrays, factors.astype(np.float32), widths, sums, *gradients)
        surface_losses_rows(*arguments)
        parts = torch.as_tensor(sums * factors, dtype=torch.float32)
        ctx.gradients = [torch.from_numpy(g) for g in gradients]
        ctx.mark_non_differentiable(parts)
        return parts.sum(), parts

    @staticmethod
    def backward(ctx: Any, scale: torch.Tensor, _: Any) -> Any:
        return (None, *[scale * g for g in ctx.gradients], None)
