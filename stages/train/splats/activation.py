"""Raw parameters to physical values, and rows of them for one view, each in one pass on the CPU (numba, float32).

Most of a training step's time went into torch's elementwise operations on short arrays, each a pass over memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from . import splat_kernels as kernels
from .gaussians import IOR_LOW, ROUGHNESS_FLOOR, Splats

_SIGMOIDS = ((0.0, 1.0), (0.0, 1.0), (ROUGHNESS_FLOOR, 1 - ROUGHNESS_FLOOR), (IOR_LOW, 1.0))  # least value, span


def _array(tensor: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy(), np.float32)


class Activation(torch.autograd.Function):
    """`SplatModel.activated_plainly` but for the means: raw tensors in the order of `gaussians.ACTIVATED` to the fields of
    `Splats`. Float32 on the CPU."""

    @staticmethod
    def forward(ctx: Any, *raw: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """normals, quaternions, scales, opacities, albedo, roughness, ior."""
        normal, log_scale, opacity, albedo, *offsets = (_array(t) for t in raw[:6])
        count = len(normal)
        normals, quaternions, scales = (np.empty((count, c), np.float32) for c in (3, 4, 2))
        kernels.orient(normal, log_scale, normals, quaternions, scales)
        shared = [0.0, 0.0, *(float(t.detach()) for t in raw[6:])]
        values = [np.empty_like(a) for a in (opacity, albedo, *offsets)]
        for a, shift, (low, span), out in zip((opacity, albedo, *offsets), shared, _SIGMOIDS, values):
            kernels.sigmoids(a.ravel(), *np.array((shift, low, span), np.float32), out.ravel())
        ctx.raw, ctx.normals, ctx.scales, ctx.values = normal, normals, scales, values
        outputs = [torch.from_numpy(a) for a in (normals, quaternions, scales, *values)]
        ctx.mark_non_differentiable(outputs[1])
        return tuple(outputs)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, ...]:
        g_normal, _, g_scale, *g_values = (_array(g) for g in gradients)
        raw, log_scale = np.empty_like(ctx.raw), np.empty(len(ctx.raw), np.float32)
        kernels.orient_slopes(ctx.raw, ctx.normals, ctx.scales, g_normal, g_scale, raw, log_scale)
        out = [np.empty_like(a) for a in ctx.values]
        for value, (low, span), g, slope in zip(ctx.values, _SIGMOIDS, g_values, out):
            kernels.sigmoid_slopes(value.ravel(), *np.array((low, span), np.float32), g.ravel(), slope.ravel())
        shared = [torch.tensor(a.sum(), dtype=torch.float32) for a in out[2:]]
        return (*(torch.from_numpy(a) for a in (raw, log_scale, *out)), *shared)


class TakenRows(torch.autograd.Function):
    """What the rasteriser wants of some splats: means, quaternions, scales, opacities and features (normal, albedo,
    roughness, IoR, extra) of `rows` [R]. The quaternions carry no gradient. Float32 on the CPU."""

    @staticmethod
    def forward(ctx: Any, rows: torch.Tensor, extra: torch.Tensor | None, *fields: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """fields: those of `Splats` in its order, means first."""
        means, normals, quaternions, scales, opacities, albedo, roughness, ior = (_array(t) for t in fields)
        more = np.empty((len(means), 0), np.float32) if extra is None else _array(extra)
        index, count = rows.numpy(), len(rows)
        out = tuple(np.empty((count, *shape), np.float32) for shape in ((3,), (4,), (2,), ()))
        features = np.empty((count, 8 + more.shape[1]), np.float32)
        kernels.take_rows(
            index, means, quaternions, scales, opacities, normals, albedo, roughness, ior, more, out, features
        )  # fmt: skip
        ctx.index, ctx.count, ctx.more, ctx.given = index, len(means), more.shape[1], extra is not None
        outputs = [torch.from_numpy(a) for a in (*out, features)]
        ctx.mark_non_differentiable(outputs[1])
        return tuple(outputs)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        mean, _, scale, opacity, features = (_array(g) for g in gradients)
        shapes = ((3,), (2,), (), (3,), (3,), (), (), (ctx.more,))
        means, scales, opacities, normals, albedo, roughness, ior, more = (
            np.zeros((ctx.count, *shape), np.float32) for shape in shapes
        )
        kernels.put_rows(
            ctx.index, (mean, scale, opacity), features, means, scales, opacities, normals, albedo, roughness, ior, more
        )  # fmt: skip
        fields = (means, normals, None, scales, opacities, albedo, roughness, ior)
        found = (None if a is None else torch.from_numpy(a) for a in fields)
        return None, torch.from_numpy(more) if ctx.given else None, *found


def taken_rows(splats: Splats, rows: torch.Tensor, extra: torch.Tensor | None) -> tuple[torch.Tensor, ...]:
    """What the rasteriser wants of the splats `rows` [R]: means, quaternions, scales, opacities, and features [R, 8 + C], which
    are normal, albedo, roughness, IoR and `extra` [N, C]."""
    fields = tuple(getattr(splats, name) for name in Splats.__dataclass_fields__)
    if all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (*fields, *([] if extra is None else [extra]))):
        return TakenRows.apply(rows, extra, *fields)
    columns = [splats.normals, splats.albedo, splats.roughness[:, None], splats.ior[:, None]]
    features = torch.cat(columns if extra is None else [*columns, extra], -1)
    return tuple(t[rows] for t in (splats.means, splats.quaternions, splats.scales, splats.opacities, features))


@torch.no_grad()
def facing(splats: Splats, centre: torch.Tensor, least: float) -> torch.Tensor:
    """Which splats [N] turn their outer side to a point [3], with a cosine above `least`."""
    if splats.means.device.type == "cpu" and splats.means.dtype == torch.float32:
        out = np.empty(len(splats.means), bool)
        kernels.facing(_array(splats.means), _array(splats.normals), _array(centre), np.float32(least), out)
        return torch.from_numpy(out)
    towards = centre - splats.means
    return (splats.normals * towards).sum(-1) > least * towards.norm(dim=-1)
