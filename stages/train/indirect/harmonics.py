"""Radiance of each Gaussian as spherical harmonics of the direction, learnt with the rest (Ref-Gaussian, Yao et al. 2025)."""

from __future__ import annotations

import torch

from pipeline.splats.harmonics import COEFFICIENTS, terms

from ..splats.gaussians import SplatModel, Splats
from ..views.source_views import MEAN_EXPOSED
from ..views.view import View

NAME = "indirect"
"""Of the coefficients [N, COEFFICIENTS, 3] among a model's tensors."""


def start_harmonics(model: SplatModel) -> None:
    """Give every Gaussian coefficients of 0: light as bright as the photographs are in the mean."""
    position = model["position"]
    model.tensors[NAME] = torch.zeros(len(position), COEFFICIENTS, 3, device=position.device, requires_grad=True)


def basis(d: torch.Tensor) -> torch.Tensor:
    """Real spherical harmonics up to degree 3 in unit directions [N, 3], orthonormal over the sphere [N, 16].

    By degree, and by order within it (-l .. l); without the sign (-1)^m of Condon and Shortley.
    """
    return torch.stack(terms(*d.unbind(-1)), -1)


def towards_mirror(model: SplatModel, splats: Splats, view: View) -> torch.Tensor:
    """Radiance [N, 3] >= 0 that each Gaussian mirrors towards a view's camera where the object stands in the way.

    Gradients reach the coefficients alone.
    """
    centre = -view.world_to_camera[:3, :3].T @ view.world_to_camera[:3, 3]
    towards = torch.nn.functional.normalize(centre - splats.means.detach(), dim=-1)
    normal = splats.normals.detach()
    mirrored = 2 * (normal * towards).sum(-1, keepdim=True) * normal - towards
    return torch.relu(MEAN_EXPOSED + torch.einsum("nk,nkc->nc", basis(mirrored), model[NAME]))
