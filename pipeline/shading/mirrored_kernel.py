"""Mirrored light at many directions in one pass (numba, float32, CPU). `LightField.mirrored_plainly` is the definition."""

from __future__ import annotations

from pipeline.kernels.compiling import kernel

from .cube_kernels import MATH, fetch, texels
from .shade_kernels import level_below


@kernel(nogil=True, fastmath=MATH, error_model="numpy")
def mirrored_rows(directions, roughness, packed, nodes, sizes, starts, index, bases, out):
    """Prefiltered radiance out [P, 3] at directions [P, 3] and perceptual roughness [P]; the rest: `LightField.tables`."""
    for p in range(len(directions)):
        level, fraction, _ = level_below(roughness[p], nodes)
        x, y, z = directions[p, 0], directions[p, 1], directions[p, 2]
        lower = texels(x, y, z, sizes[level], index, bases[level])
        upper = texels(x, y, z, sizes[level + 1], index, bases[level + 1])
        for k in range(3):
            below = fetch(packed, starts[level], lower, k)[0]
            above = fetch(packed, starts[level + 1], upper, k)[0]
            out[p, k] = below + (above - below) * fraction
