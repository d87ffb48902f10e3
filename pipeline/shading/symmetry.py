"""Filters of cube maps that treat all directions alike, stored once per orbit of the cube's 48 symmetries.

A filter's row at a texel g t is its row at t with the sources moved by g. So only one row per orbit is stored
(1/48 to 1/24 of all), and 48 rows are evaluated at once as one gathered, vectorised product:

    X[s, g] = x[g s],    Y = W X,    out[g t] = Y[t, g]
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache
from itertools import permutations, product
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pipeline.kernels.compiling import kernel

from .cube import corner_texels, cube_directions, extended_size, texel_of

ORDER = 48
# Values of one source under all symmetries, side by side: 48 x RGB.
WIDTH = ORDER * 3


@lru_cache(maxsize=32)
def texel_images(resolution: int) -> NDArray[np.int32]:
    """Index of the texel that each symmetry moves each texel to [48, 6 R^2]; the first symmetry is the identity."""
    d = cube_directions(resolution).reshape(-1, 3)
    return np.stack(
        [
            texel_of(np.asarray(signs) * d[:, axes], resolution)
            for axes in permutations(range(3))
            for signs in product((1.0, -1.0), repeat=3)
        ]
    ).astype(np.int32)


@lru_cache(maxsize=32)
def representatives(resolution: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(texels that stand for their orbits [M], for every texel the position (row * 48 + g) that computes it)."""
    images = texel_images(resolution)
    texels = np.flatnonzero(images.min(axis=0) == np.arange(images.shape[1]))
    where = np.empty(images.shape[1], np.int64)
    # Texels on a mirror plane are reached by several symmetries: any one will do.
    where[images[:, texels].T.ravel()] = np.arange(len(texels) * ORDER)
    return texels, where


@kernel
def _spread(x, images, out):
    for s in range(images.shape[0]):
        for g in range(ORDER):
            for c in range(3):
                out[s, 3 * g + c] = x[images[s, g], c]


@kernel
def _gather(x, inverse, out):
    """out[s] = sum over g of x[inverse[s, g], g]: the adjoint of `_spread`."""
    for s in range(out.shape[0]):
        r, g, b = np.float32(0), np.float32(0), np.float32(0)
        for k in range(ORDER):
            row = inverse[s, k]
            r += x[row, 3 * k]
            g += x[row, 3 * k + 1]
            b += x[row, 3 * k + 2]
        out[s, 0], out[s, 1], out[s, 2] = r, g, b


@kernel(parallel=True, fastmath=True)
def _multiply(starts, columns, values, x, out):
    for row in prange(len(starts) - 1):
        total = np.zeros(WIDTH, np.float32)
        first, last = starts[row], starts[row + 1]
        whole = first + (last - first) // 4 * 4
        for k in range(first, whole, 4):  # four sources for each pass over the sums
            a, b, c, d = values[k], values[k + 1], values[k + 2], values[k + 3]
            p, q, r, s = x[columns[k]], x[columns[k + 1]], x[columns[k + 2]], x[columns[k + 3]]
            for j in range(WIDTH):
                total[j] += a * p[j] + b * q[j] + c * r[j] + d * s[j]
        for k in range(whole, last):
            w, source = values[k], x[columns[k]]
            for j in range(WIDTH):
                total[j] += w * source[j]
        out[row] = total


@kernel
def _collect(y, texel, position, corner, meeting, packed):
    """Output tables from the products: every texel from its orbit's row, every corner from the texels around it."""
    for k in range(len(texel)):
        for c in range(3):
            packed[texel[k], c] = y[position[k], c]
    for k in range(len(corner)):
        for c in range(3):
            total = packed[meeting[k, 0], c] + packed[meeting[k, 1], c] + packed[meeting[k, 2], c]
            packed[corner[k], c] = total / np.float32(3)


@kernel
def _distribute(packed, texel, position, corner, meeting, y):
    """Adjoint of `_collect`; y zeroed."""
    where = np.empty(len(packed), np.int64)
    for k in range(len(texel)):
        where[texel[k]] = position[k]
        for c in range(3):
            y[position[k], c] = packed[texel[k], c]
    for k in range(len(corner)):
        for m in range(3):
            for c in range(3):
                y[where[meeting[k, m]], c] += packed[corner[k], c] / np.float32(3)


class SymmetricMap:
    """packed = filters of x: [S, 3] -> [T, 3], each output level an extended cube (`cube.extended_size`).

    sizes: resolutions of the cubes stacked in x. levels: resolutions of the outputs. matrix: weights [sum of the
    levels' representatives, S]. float32 on the CPU runs fused kernels, anything else torch's CSR product.
    """

    def __init__(self, sizes: Sequence[int], levels: Sequence[int], matrix: csr_matrix) -> None:
        offsets = np.concatenate(([0], np.cumsum([6 * n * n for n in sizes])))
        self._images = np.ascontiguousarray(
            np.concatenate([texel_images(n) + o for n, o in zip(sizes, offsets)], axis=1).T, np.int32
        )
        inverse = np.empty_like(self._images)
        for g in range(ORDER):
            inverse[self._images[:, g], g] = np.arange(offsets[-1])
        self._inverse = inverse
        where, corners, rows, start = [], [], 0, 0
        for n in levels:
            texels, position = representatives(n)
            where.append((start + np.arange(6 * n * n), rows * ORDER + position))
            corners.append((start + 6 * n * n + np.arange(8), start + corner_texels(n)))
            rows += len(texels)
            start += extended_size(n)
        self.size = start
        self._texel, self._position = (torch.as_tensor(np.concatenate(x)) for x in zip(*where))
        self._corner, self._meeting = (torch.as_tensor(np.concatenate(x)) for x in zip(*corners))
        self._places = tuple(x.numpy() for x in (self._texel, self._position, self._corner, self._meeting))
        self._matrix = matrix.tocsr()
        self._arrays = tuple(
            (m.indptr.astype(np.int64), m.indices.astype(np.int32), m.data.astype(np.float32))
            for m in (self._matrix, self._matrix.T.tocsr())
        )
        self._torch: dict[tuple[torch.device, torch.dtype], tuple[torch.Tensor, ...]] = {}

    @property
    def entries(self) -> int:
        """Stored weights; each serves 48 rows."""
        return int(self._matrix.nnz)

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        if x.device.type == "cpu" and x.dtype == torch.float32:
            return _FusedExpansion.apply(x, self)
        return self.plain(x)

    def plain(self, x: torch.Tensor) -> torch.Tensor:
        """The map in torch operations, any device and float type: the definition."""
        key = (x.device, x.dtype)
        if key not in self._torch:
            weights = torch_csr(self._matrix)
            indices = (torch.as_tensor(self._images).long(), self._texel, self._position, self._corner, self._meeting)
            self._torch[key] = (weights.to(x.device, x.dtype), *(i.to(x.device) for i in indices))
        weights, images, texel, position, corner, meeting = self._torch[key]
        y = (weights @ x[images].reshape(-1, WIDTH)).reshape(-1, 3)
        packed = x.new_zeros(self.size, 3).index_copy(0, texel, y[position])
        return packed.index_copy(0, corner, packed[meeting].mean(1))

    def forward(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Fused product."""
        spread = np.empty((len(self._images), WIDTH), np.float32)
        _spread(x, self._images, spread)
        y = np.empty((self._matrix.shape[0], WIDTH), np.float32)
        _multiply(*self._arrays[0], spread, y)
        packed = np.empty((self.size, 3), np.float32)
        collect: Any = _collect
        collect(y.reshape(-1, 3), *self._places, packed)
        return packed

    def backward(self, gradient: NDArray[np.float32]) -> NDArray[np.float32]:
        """Product with the transpose."""
        y = np.zeros((self._matrix.shape[0] * ORDER, 3), np.float32)
        distribute: Any = _distribute
        distribute(gradient, *self._places, y)
        spread = np.empty((len(self._images), WIDTH), np.float32)
        _multiply(*self._arrays[1], y.reshape(-1, WIDTH), spread)
        x = np.empty((len(self._images), 3), np.float32)
        _gather(spread, self._inverse, x)
        return x


def torch_csr(matrix: csr_matrix) -> torch.Tensor:
    """The same sparse matrix in torch."""
    arrays = [torch.as_tensor(a) for a in (matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32), matrix.data)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # torch calls CSR beta; the arrays are scipy's, and valid
        return torch.sparse_csr_tensor(arrays[0], arrays[1], arrays[2], size=matrix.shape)


class _FusedExpansion(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, operator: SymmetricMap) -> torch.Tensor:
        ctx.operator = operator
        return torch.from_numpy(operator.forward(x.detach().contiguous().numpy()))

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        return torch.from_numpy(ctx.operator.backward(gradients[0].contiguous().numpy())), None
