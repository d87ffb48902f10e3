"""Raw parameters of splats to physical values in one pass on the CPU (numba, float32).

Most of a training step's time went into torch's elementwise operations on short arrays, each a pass over memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from . import splat_kernels as kernels

Ranges = tuple[tuple[float, float], ...]


def array(tensor: torch.Tensor) -> np.ndarray:
    """A tensor's values of any shape, contiguous float32, without a copy where they are so already."""
    return np.ascontiguousarray(tensor.detach().numpy(), np.float32)


class Activation(torch.autograd.Function):
    """`SplatModel.activated_plainly` but for the means: raw tensors in the order of `gaussians.ACTIVATED` to the fields of
    `Splats`. Float32 on the CPU."""

    @staticmethod
    def forward(ctx: Any, ranges: Ranges, *raw: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """normals, quaternions, scales, opacities, albedo, roughness, ior; `ranges`: least value and span of the last four."""
        normal, log_scale, opacity, albedo, *offsets = (array(t) for t in raw[:6])
        count = len(normal)
        normals, quaternions, scales = (np.empty((count, c), np.float32) for c in (3, 4, 2))
        kernels.orient(normal, log_scale, normals, quaternions, scales)
        shared = [0.0, 0.0, *(float(t.detach()) for t in raw[6:])]
        values = [np.empty_like(a) for a in (opacity, albedo, *offsets)]
        for a, shift, (low, span), out in zip((opacity, albedo, *offsets), shared, ranges, values):
            kernels.sigmoids(a.ravel(), *np.array((shift, low, span), np.float32), out.ravel())
        ctx.raw, ctx.normals, ctx.scales, ctx.values, ctx.ranges = normal, normals, scales, values, ranges
        outputs = [torch.from_numpy(a) for a in (normals, quaternions, scales, *values)]
        ctx.mark_non_differentiable(outputs[1])
        return tuple(outputs)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        g_normal, _, g_scale, *g_values = (array(g) for g in gradients)
        raw, log_scale = np.empty_like(ctx.raw), np.empty(len(ctx.raw), np.float32)
        kernels.orient_slopes(ctx.raw, ctx.normals, ctx.scales, g_normal, g_scale, raw, log_scale)
        out = [np.empty_like(a) for a in ctx.values]
        for value, (low, span), g, slope in zip(ctx.values, ctx.ranges, g_values, out):
            kernels.sigmoid_slopes(value.ravel(), *np.array((low, span), np.float32), g.ravel(), slope.ravel())
        shared = [torch.tensor(a.sum(), dtype=torch.float32) for a in out[2:]]
        return (None, *(torch.from_numpy(a) for a in (raw, log_scale, *out)), *shared)
