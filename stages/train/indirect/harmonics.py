"""Radiance of each Gaussian as spherical harmonics of the direction, learnt with the rest (Ref-Gaussian, Yao et al. 2025)."""

from __future__ import annotations

import torch

from ..splats.gaussians import SplatModel, Splats
from ..views.source_views import MEAN_EXPOSED
from ..views.view import View

NAME = "indirect"
"""Of the coefficients [N, COEFFICIENTS, 3] among a model's tensors."""
COEFFICIENTS = 16  # degree 3, as 3D Gaussian splatting has them


def start_harmonics(model: SplatModel) -> None:
    """Give every Gaussian coefficients of 0: light as bright as the photographs are in the mean."""
    position = model["position"]
    model.tensors[NAME] = torch.zeros(len(position), COEFFICIENTS, 3, device=position.device, requires_grad=True)


def basis(d: torch.Tensor) -> torch.Tensor:
    """Real spherical harmonics up to degree 3 in unit directions [N, 3], orthonormal over the sphere [N, 16].

    By degree, and by order within it (-l .. l); without the sign (-1)^m of Condon and Shortley.
    """
    x, y, z = d.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            torch.full_like(x, 0.28209479177387814),
            *(0.4886025119029199 * v for v in (y, z, x)),
            1.0925484305920792 * x * y,
            1.0925484305920792 * y * z,
            0.31539156525252005 * (3 * zz - 1),
            1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            0.4570457994644658 * y * (5 * zz - 1),
            0.3731763325901154 * z * (5 * zz - 3),
            0.4570457994644658 * x * (5 * zz - 1),
            1.445305721320277 * z * (xx - yy),
            0.5900435899266435 * x * (xx - 3 * yy),
        ],
        -1,
    )


def towards_mirror(model: SplatModel, splats: Splats, view: View) -> torch.Tensor:
    """Radiance [N, 3] >= 0 that each Gaussian mirrors towards a view's camera where the object stands in the way.

    Gradients reach the coefficients alone.
    """
    centre = -view.world_to_camera[:3, :3].T @ view.world_to_camera[:3, 3]
    towards = torch.nn.functional.normalize(centre - splats.means.detach(), dim=-1)
    normal = splats.normals.detach()
    mirrored = 2 * (normal * towards).sum(-1, keepdim=True) * normal - towards
    return torch.relu(MEAN_EXPOSED + torch.einsum("nk,nkc->nc", basis(mirrored), model[NAME]))
