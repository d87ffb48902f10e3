"""The octahedral map: directions over the sphere as the texels of a square (Meyer et al. 2010)."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

_ONE, _ZERO = np.float32(1), np.float32(0)
_TINY = np.float32(1e-30)  # of a direction without length, which has no texel of its own: the middle's


def octahedral_directions(size: int) -> np.ndarray:
    """Unit directions of the texels of an octahedral map, float32 [size, size, 3] (rows: z, columns: x)."""
    t = (2 * np.arange(size) + 1) / size - 1
    z, x = np.meshgrid(t, t, indexing="ij")
    y = 1 - np.abs(x) - np.abs(z)
    low = y < 0
    folded_x = np.where(low, (1 - np.abs(z)) * np.where(x >= 0, 1, -1), x)
    folded_z = np.where(low, (1 - np.abs(x)) * np.where(z >= 0, 1, -1), z)
    d = np.stack([folded_x, y, folded_z], -1)
    return (d / np.linalg.norm(d, axis=-1, keepdims=True)).astype(np.float32)


@kernel(nogil=True, fastmath=True, error_model="numpy")
def octahedral_texel(x, y, z, size):
    """Row and column of a direction in the octahedral map."""
    scale = _ONE / max(abs(x) + abs(y) + abs(z), _TINY)
    u, v = x * scale, z * scale
    if y < _ZERO:
        a, b = _ONE - abs(v), _ONE - abs(u)
        u, v = (a if u >= _ZERO else -a), (b if v >= _ZERO else -b)
    half = np.float32(0.5 * size)
    return (
        min(max(int((v + _ONE) * half), 0), size - 1),
        min(max(int((u + _ONE) * half), 0), size - 1),
    )
