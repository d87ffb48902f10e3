"""Neighbourhoods on the surface, and the terms and operators that live on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy import sparse
from scipy.spatial import cKDTree

NEIGHBOURS = 8


@dataclass(frozen=True)
class SurfaceGraph:
    """Undirected edges i < j between neighbouring splats on the same side of the surface.

    edges [2, E]; length [E] (rest distance); spacing: mean edge length; average [N, N]: sparse row-stochastic matrix
    (0.5 self + 0.5 neighbours), symmetric up to row scaling, for diffusing updates.
    """

    edges: torch.Tensor
    length: torch.Tensor
    spacing: float
    average: torch.Tensor

    def smooth(self, values: torch.Tensor, rounds: int) -> torch.Tensor:
        """`rounds` diffusion steps of per-splat values [N, C]."""
        for _ in range(rounds):
            values = self.average @ values
        return values


def build_graph(positions: torch.Tensor, normals: torch.Tensor) -> SurfaceGraph:
    """Graph of the nearest neighbours whose normals agree (within 75 degrees) and that lie beside, not behind."""
    p, n = positions.detach().cpu().double().numpy(), normals.detach().cpu().double().numpy()
    count = len(p)
    distance, index = cKDTree(p).query(p, k=min(NEIGHBOURS + 1, count))
    i = np.repeat(np.arange(count), index.shape[1] - 1)
    j, d = index[:, 1:].ravel(), distance[:, 1:].ravel()
    typical = np.median(distance[:, 1:])
    facing = (n[i] * n[j]).sum(-1) > 0.26
    beside = np.abs(((p[j] - p[i]) * (n[i] + n[j])).sum(-1)) < 1.2 * d
    kept = facing & beside & (d < 4 * typical) & (d > 0)
    pairs = np.unique(np.sort(np.stack([i[kept], j[kept]], -1), -1), axis=0)
    a, b = pairs[:, 0], pairs[:, 1]
    ones = np.ones(len(a), np.float32)
    links = sparse.coo_matrix((np.r_[ones, ones], (np.r_[a, b], np.r_[b, a])), (count, count)).tocsr()
    degree = np.maximum(np.asarray(links.sum(1)).ravel(), 1)
    matrix = (0.5 * sparse.eye(count) + 0.5 * sparse.diags(1 / degree) @ links).tocsr().astype(np.float32)
    alone = np.asarray(links.sum(1)).ravel() == 0
    matrix = (matrix + sparse.diags(0.5 * alone.astype(np.float32))).tocsr()
    average = torch.sparse_csr_tensor(
        torch.as_tensor(matrix.indptr.astype(np.int64)),
        torch.as_tensor(matrix.indices.astype(np.int64)),
        torch.as_tensor(matrix.data.astype(np.float32)),
        (count, count),
    ).to(positions.device)
    length = np.linalg.norm(p[a] - p[b], axis=-1)
    return SurfaceGraph(
        edges=torch.as_tensor(pairs.T.copy(), device=positions.device),
        length=torch.as_tensor(length.astype(np.float32), device=positions.device),
        spacing=float(length.mean()) if len(length) else float(typical),
        average=average,
    )


def slope_residual(graph: SurfaceGraph, positions: torch.Tensor, normals: torch.Tensor) -> torch.Tensor:
    """Disagreement of positions with normals along every edge (radians) [E].

    The chord against the mean of its two normals: zero on planes and on every sphere and cylinder, unlike the plane-to-point
    distance, so smooth curvature is not penalised.
    """
    i, j = graph.edges
    chord = positions[j] - positions[i]
    return (chord * (normals[i] + normals[j])).sum(-1) / (2 * graph.length)


def edge_difference(graph: SurfaceGraph, values: torch.Tensor) -> torch.Tensor:
    """Differences of per-splat values along the edges [E, C] (or [E])."""
    i, j = graph.edges
    return values[j] - values[i]
