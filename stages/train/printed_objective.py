"""What a rendering is compared with as PhyGaP prints it (Eq. 10): `train.losses=printed`."""

from __future__ import annotations

import torch

from .parameters import TrainParameters
from .pixel_attributes import LEAST_ALPHA
from .render_view import Rendered
from .views import printed_losses as losses
from .views.source_views import Mode
from .views.view import View


def printed_terms(
    p: TrainParameters, mode: Mode, view: View, rendered: Rendered, predicted: torch.Tensor, target: torch.Tensor
) -> dict[str, torch.Tensor]:
    """The five weighted terms by name.

    Args:
        p: weights: lambda 1 to 4, and the share of DSSIM in L_rgb.
        mode: only "stokes" has a polarisation term.
        view, rendered: what was measured, and the rendering of it.
        predicted, target: what the camera measures of both (`objective.compared`). [P, 3]
    """
    g = rendered.gbuffer
    absolute, structure = losses.rgb_loss(predicted, target, view)
    depth = g.raster.depth_expected.reshape(-1)[view.pixels] / g.alpha.clamp_min(LEAST_ALPHA)
    terms = {
        "rgb": p.weight_rgb * (1 - p.weight_dssim) * absolute,
        "dssim": p.weight_rgb * p.weight_dssim * structure,
        "mask": p.weight_mask * losses.mask_loss(g.alpha_image, view),
        "depth_normal": p.weight_depth_normal * losses.depth_normal_loss(g.normal, depth, g.alpha, view),
        "smooth": p.weight_smooth * losses.smooth_loss(g.normal, target, view),
    }
    if mode == "stokes" and p.weight_polarisation > 0:
        terms["polarisation"] = p.weight_polarisation * losses.polarisation_loss(rendered.stokes, view.target, view)
    return terms
