"""Sparse linear maps of [n, 3] tables, with their transposes: numba on the CPU, torch's CSR elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit, prange
from scipy.sparse import csr_matrix


@njit(cache=True, parallel=True, fastmath=True)
def _multiply(starts, columns, values, x, out):
    for row in prange(len(starts) - 1):
        r, g, b = np.float32(0), np.float32(0), np.float32(0)
        for k in range(starts[row], starts[row + 1]):
            w, c = values[k], columns[k]
            r += w * x[c, 0]
            g += w * x[c, 1]
            b += w * x[c, 2]
        out[row, 0], out[row, 1], out[row, 2] = r, g, b


class SparseMap:
    """y = M x for x [n, 3]; differentiable in x. float32 runs the fused kernel on the CPU, other types torch's."""

    def __init__(self, matrix: csr_matrix) -> None:
        self.shape = matrix.shape
        forward, backward = matrix.tocsr(), matrix.T.tocsr()
        self._arrays = tuple(
            (m.indptr.astype(np.int64), m.indices.astype(np.int32), m.data.astype(np.float32)) for m in (forward, backward)
        )
        self._matrix = forward
        self._torch: dict[tuple[torch.device, torch.dtype], tuple[torch.Tensor, torch.Tensor]] = {}

    @property
    def entries(self) -> int:
        """Stored weights."""
        return int(self._matrix.nnz)

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        return _Apply.apply(x, self)

    def multiply(self, x: torch.Tensor, transposed: bool) -> torch.Tensor:
        """M x, or M^T x; no autograd."""
        rows = self.shape[1] if transposed else self.shape[0]
        if x.device.type == "cpu" and x.dtype == torch.float32 and x.shape[1] == 3:
            out = torch.empty((rows, 3), dtype=x.dtype)
            _multiply(*self._arrays[transposed], x.contiguous().numpy(), out.numpy())
            return out
        key = (x.device, x.dtype)
        if key not in self._torch:
            self._torch[key] = tuple(  # type: ignore[assignment]
                torch.sparse_csr_tensor(
                    torch.as_tensor(m.indptr.astype(np.int64)),
                    torch.as_tensor(m.indices.astype(np.int64)),
                    torch.as_tensor(m.data),
                    size=m.shape,
                ).to(device=x.device, dtype=x.dtype)
                for m in (self._matrix, self._matrix.T.tocsr())
            )
        return self._torch[key][transposed] @ x


class _Apply(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, operator: SparseMap) -> torch.Tensor:
        ctx.operator = operator
        return operator.multiply(x.detach(), transposed=False)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        return ctx.operator.multiply(gradients[0], transposed=True), None
