"""Neighbourhoods on the surface, and the terms and operators that live on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy import sparse
from scipy.spatial import cKDTree

NEIGHBOURS = 8


@dataclass(frozen=True)
class SurfaceGraph:
    """Undirected edges i < j between neighbouring splats on the same side of the surface.

    edges [2, E]; indptr [N + 1], indices [2 E]: each splat's neighbours (int32); spacing: mean edge length.
    """

    edges: torch.Tensor
    indptr: torch.Tensor
    indices: torch.Tensor
    spacing: float

    def __len__(self) -> int:
        return len(self.indptr) - 1

    def diffuse(self, values: torch.Tensor, rounds: int) -> torch.Tensor:
        """`rounds` steps of replacing per-splat values [N, C] by half themselves and half their neighbours' mean."""
        if values.device.type == "cpu":
            return self._diffuse_cpu(values, rounds)
        return self.diffuse_plainly(values, rounds)

    def diffuse_plainly(self, values: torch.Tensor, rounds: int) -> torch.Tensor:
        """`diffuse` in torch, in one order of summation on any device: the definition."""
        half = 0.5 / (self.neighbours < len(self)).sum(1, keepdim=True).to(values.dtype)  # infinite where there is none
        for _ in range(rounds):
            total = torch.cat((values, values.new_zeros(1, values.shape[1])))[self.neighbours].sum(1)
            values = torch.where(half < 1, torch.addcmul(0.5 * values, half, total), values)
        return values

    @cached_property
    def neighbours(self) -> torch.Tensor:
        """Each splat's neighbours, filled up with N. [N, most of any] int64"""
        degree = self.indptr[1:] - self.indptr[:-1]
        place = torch.arange(int(degree.max()) if len(self) else 0, device=degree.device)
        row = (self.indptr[:-1, None] + place).clamp_max(max(len(self.indices) - 1, 0))
        return torch.where(place < degree[:, None], self.indices[row.long()], len(self)).long()

    def _diffuse_cpu(self, values: torch.Tensor, rounds: int) -> torch.Tensor:
        from .surface_kernels import diffuse_rows

        indptr, indices = self.indptr.numpy(), self.indices.numpy()
        a = np.ascontiguousarray(values.detach().numpy())
        b = np.empty_like(a)
        for _ in range(rounds):
            diffuse_rows(0, len(a), indptr, indices, a, b)
            a, b = b, (a if a.base is None else np.empty_like(a))
        return torch.from_numpy(a)


def build_graph(positions: torch.Tensor, normals: torch.Tensor) -> SurfaceGraph:
    """Graph of the nearest neighbours whose normals agree (within 75 degrees) and that lie beside, not behind."""
    p, n = positions.detach().cpu().double().numpy(), normals.detach().cpu().double().numpy()
    n = n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)  # a zero normal has no neighbours
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
    ones = np.ones(len(a), np.int8)
    links = sparse.coo_matrix((np.r_[ones, ones], (np.r_[a, b], np.r_[b, a])), (count, count)).tocsr()
    links.sort_indices()
    device = positions.device
    return SurfaceGraph(
        edges=torch.as_tensor(pairs.T.copy(), device=device),
        indptr=torch.as_tensor(links.indptr.astype(np.int32), device=device),
        indices=torch.as_tensor(links.indices.astype(np.int32), device=device),
        spacing=float(np.linalg.norm(p[a] - p[b], axis=-1).mean()) if len(a) else float(typical),
    )


def slope_residual(graph: SurfaceGraph, positions: torch.Tensor, normals: torch.Tensor) -> torch.Tensor:
    """Disagreement of positions with normals along every edge (radians) [E].

    The chord against the mean of its two normals: zero on planes and on every sphere and cylinder, unlike the plane-to-point
    distance, so smooth curvature is not penalised. The chord's length is taken as constant.
    """
    i, j = graph.edges
    chord = positions[j] - positions[i]
    length = torch.sqrt((chord.detach() ** 2).sum(-1) + 1e-20)  # coincident splats: no chord, no term
    return (chord * (normals[i] + normals[j])).sum(-1) / (2 * length)


def edge_difference(graph: SurfaceGraph, values: torch.Tensor) -> torch.Tensor:
    """Differences of per-splat values along the edges [E, C] (or [E])."""
    i, j = graph.edges
    return values[j] - values[i]
