"""Bilinear lookups in packed cube maps and their adjoints, which shading's kernels share (numba, float32).

`cube.lookup` is the readable definition.
"""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

from .cube import AXES

_AXES = AXES.astype(np.float32)
_ONE, _TWO, _HALF_ONE = np.float32(1), np.float32(2), np.float32(0.5)
_TINY = np.float32(1e-9)
# Everything of fastmath but the licence to ignore NaN and infinity: bad pixels must not become bad indices.
MATH = {"nsz", "arcp", "contract", "afn", "reassoc"}


@kernel(fastmath=MATH, error_model="numpy")
def texels(dx, dy, dz, size, index, base):
    """Where a direction falls: face, (u, v), 1/major, fractions (s, t) and the four rows of the extended table."""
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        face = 1 if dx < 0 else 0
        major = ax
    elif ay >= az:
        face = 3 if dy < 0 else 2
        major = ay
    else:
        face = 5 if dz < 0 else 4
        major = az
    inverse = _ONE / max(major, _TINY)
    u = (dx * _AXES[face, 1, 0] + dy * _AXES[face, 1, 1] + dz * _AXES[face, 1, 2]) * inverse
    v = (dx * _AXES[face, 2, 0] + dy * _AXES[face, 2, 1] + dz * _AXES[face, 2, 2]) * inverse
    half = _HALF_ONE * np.float32(size)
    s = (u + _ONE) * half + _HALF_ONE
    t = (v + _ONE) * half + _HALF_ONE
    i = min(max(int(s), 0), size)
    j = min(max(int(t), 0), size)
    row = base + (face * (size + 2) + j) * (size + 2) + i
    below = row + size + 2
    return (
        face, u, v, inverse, s - np.float32(i), t - np.float32(j),
        index[row], index[row + 1], index[below], index[below + 1],
    )  # fmt: skip


@kernel(fastmath=MATH, error_model="numpy")
def fetch(packed, start, where, k):
    """Channel k at a lookup, and its slopes in s and t."""
    _, _, _, _, s, t, a, b, c, d = where
    a, b, c, d = packed[start + a, k], packed[start + b, k], packed[start + c, k], packed[start + d, k]
    top, bottom = a + (b - a) * s, c + (d - c) * s
    return top + (bottom - top) * t, (b - a) * (_ONE - t) + (d - c) * t, bottom - top


@kernel(fastmath=MATH, error_model="numpy")
def add(packed, start, where, k, value):
    """Adjoint of `fetch` in the table."""
    _, _, _, _, s, t, a, b, c, d = where
    packed[start + a, k] += value * (_ONE - s) * (_ONE - t)
    packed[start + b, k] += value * s * (_ONE - t)
    packed[start + c, k] += value * (_ONE - s) * t
    packed[start + d, k] += value * s * t


@kernel(fastmath=MATH, error_model="numpy")
def direction_gradient(where, size, gs, gt):
    """Gradient in the direction of gradients in s and t."""
    face, u, v, inverse = where[0], where[1], where[2], where[3]
    gu = gs * _HALF_ONE * np.float32(size) * inverse
    gv = gt * _HALF_ONE * np.float32(size) * inverse
    gn = -(gu * u + gv * v)
    n, a, b = _AXES[face, 0], _AXES[face, 1], _AXES[face, 2]
    return (
        gu * a[0] + gv * b[0] + gn * n[0],
        gu * a[1] + gv * b[1] + gn * n[1],
        gu * a[2] + gv * b[2] + gn * n[2],
    )


@kernel(fastmath=MATH, error_model="numpy")
def mirrored_texels(h, vh, v, level, sizes, index, bases):
    """Where the mirror direction of view v at half vector h falls, in a level and in the next; vh: their cosine."""
    d0, d1, d2 = _TWO * vh * h[0] - v[0], _TWO * vh * h[1] - v[1], _TWO * vh * h[2] - v[2]
    return (
        texels(d0, d1, d2, sizes[level], index, bases[level]),
        texels(d0, d1, d2, sizes[level + 1], index, bases[level + 1]),
    )
