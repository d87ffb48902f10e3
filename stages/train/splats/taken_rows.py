"""Rows of the splats for one view, taken in one pass on the CPU (numba, float32), and which rows those are."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from . import splat_kernels as kernels
from .activation import array
from .gaussians import Splats

Taken = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


class TakenRows(torch.autograd.Function):
    """What the rasteriser wants of some splats: means, quaternions, scales, opacities and features (normal, albedo,
    roughness, IoR, extra) of `rows` [R]. The quaternions carry no gradient. Float32 on the CPU."""

    @staticmethod
    def forward(ctx: Any, rows: torch.Tensor, extra: torch.Tensor | None, *fields: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """fields: those of `Splats` in its order, means first."""
        means, normals, quaternions, scales, opacities, albedo, roughness, ior = (array(t) for t in fields)
        more = np.empty((len(means), 0), np.float32) if extra is None else array(extra)
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
        mean, _, scale, opacity, features = (array(g) for g in gradients)
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


def taken_rows(splats: Splats, rows: torch.Tensor, extra: torch.Tensor | None) -> Taken:
    """What the rasteriser wants of the splats `rows` [R]: means, quaternions, scales, opacities, and features [R, 8 + C], which
    are normal, albedo, roughness, IoR and `extra` [N, C]."""
    fields = tuple(getattr(splats, name) for name in Splats.__dataclass_fields__)
    if all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (*fields, *([] if extra is None else [extra]))):
        return TakenRows.apply(rows, extra, *fields)
    columns = [splats.normals, splats.albedo, splats.roughness[:, None], splats.ior[:, None]]
    features = torch.cat(columns if extra is None else [*columns, extra], -1)
    means, quaternions, scales = splats.means[rows], splats.quaternions[rows], splats.scales[rows]
    return means, quaternions, scales, splats.opacities[rows], features[rows]


@torch.no_grad()
def cosines(splats: Splats, centre: torch.Tensor) -> torch.Tensor:
    """Cosine [N] between each splat's normal, on its outer side, and the direction to a point [3]."""
    if splats.means.device.type == "cpu" and splats.means.dtype == torch.float32:
        out = np.empty(len(splats.means), np.float32)
        kernels.cosines(array(splats.means), array(splats.normals), array(centre), out)
        return torch.from_numpy(out)
    towards = centre - splats.means
    return (splats.normals * towards).sum(-1) / towards.norm(dim=-1).clamp_min(1e-15)
