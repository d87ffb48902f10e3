"""The loss of a step (PhyGaP Eq. 10) from its terms, and what of a rendering is compared with what was measured."""

from __future__ import annotations

import torch

from .parameters import TrainParameters
from .printed_objective import printed_terms
from .render_view import Rendered
from .scene import Scene
from .splats.surface_losses import SurfaceWeights, surface_loss
from .views import losses
from .views.dssim import dssim
from .views.source_views import Mode
from .views.view import View

# Shares of train.weight_smooth. An object's colours vary by nature, its normals and material hardly do; and an offset
# that its neighbours share is evidence, so its size is held back less than its differences.
ALBEDO_SHARE, OFFSET_SIZE_SHARE = 0.2, 0.1
ENVIRONMENT_UNIT = 0.002  # per unit of train.weight_environment: a log step between texels beside an encoded one of pixels


def compared(mode: Mode, scene: Scene, stokes: torch.Tensor, view: View) -> tuple[torch.Tensor, torch.Tensor]:
    """What a camera measures, from a rendering and from the capture.

    Args:
        mode: what the views hold; only "polarisers" looks through the camera's polariser.
        scene: for its polarisers.
        stokes: rendered radiance. [P, 3, 3]
        view: its camera names the polariser.

    Returns:
        (predicted, measured) [P, 3]: s0, or twice the intensity behind the polariser (PhyGaP Eqs. 31, 32).
    """
    if mode == "polarisers" and scene.bank is not None:
        return scene.bank.intensity(stokes, view.camera.name), 2 * view.target[:, 0]
    return stokes[:, 0], view.target[:, 0]


def loss_terms(
    parameters: TrainParameters, mode: Mode, scene: Scene, view: View, rendered: Rendered
) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """All weighted losses of a view (PhyGaP Eq. 10, and the environment's smoothness).

    Args:
        parameters: weights.
        mode: what the views hold.
        scene: model, environment, polarisers and surface graph.
        view, rendered: what was measured, and the scene's rendering of it.

    Returns:
        Scalars by name, whose sum is the step's loss, and the parts of "surface", without a gradient.
    """
    environment = ENVIRONMENT_UNIT * parameters.weight_environment * scene.environment.roughness_of()
    if parameters.losses == "printed" and len(view.pixels):
        terms = printed_terms(parameters, mode, view, rendered, *compared(mode, scene, rendered.stokes, view))
        return terms | {"environment": environment}, {}
    terms = _image_terms(parameters, mode, scene, view, rendered)
    mask = losses.mask_loss(rendered.gbuffer.alpha_image, view.alpha_target, view.alpha_weight)
    terms["mask"] = parameters.weight_mask * mask
    terms["surface"], parts = _surface_term(parameters, scene, rendered)
    terms["environment"] = environment
    return terms, {"depth_normal": parts[0], "smooth": parts[1:].sum()}


def _image_terms(p: TrainParameters, mode: Mode, scene: Scene, view: View, rendered: Rendered) -> dict[str, torch.Tensor]:
    """Radiance and polarisation losses, as the data allow."""
    terms = _radiance_terms(p, view, *compared(mode, scene, rendered.stokes, view))
    if mode == "stokes" and p.weight_polarisation > 0:
        # Stokes parts and radiance are both in encoded units, so that the weight is a ratio of display steps.
        unlike = losses.stokes_loss(rendered.stokes, view.target, view.colour_weight)
        terms["polarisation"] = p.weight_polarisation * unlike
    return terms


def _radiance_terms(p: TrainParameters, view: View, predicted: torch.Tensor, target: torch.Tensor) -> dict[str, torch.Tensor]:
    """L_rgb of [P, 3] radiance: (1 - w) times the pixelwise loss and w times the structural one, as its two terms."""
    share = p.weight_dssim
    terms = {"rgb": p.weight_rgb * (1 - share) * losses.radiance_loss(predicted, target, view.colour_weight)}
    if share > 0 and len(view.pixels):
        unlike = dssim(losses.encode(predicted), losses.encode(target), view.pixels, view.size)
        terms["dssim"] = p.weight_rgb * share * unlike
    return terms


def _surface_term(p: TrainParameters, scene: Scene, rendered: Rendered) -> tuple[torch.Tensor, torch.Tensor]:
    """Agreement of normals with positions and smoothness over the surface graph: their sum, and the parts [5]."""
    splats, smooth = rendered.splats, p.weight_smooth
    offsets = torch.stack([scene.model["roughness_offset"], scene.model["ior_offset"]], -1)
    if scene.groups is not None:
        offsets = scene.groups.held(offsets)  # what splats of one colour share is a material of its own
    weights = SurfaceWeights(p.weight_depth_normal, smooth, ALBEDO_SHARE * smooth, smooth, OFFSET_SIZE_SHARE * smooth)
    return surface_loss(scene.linked(), splats.means, splats.normals, splats.albedo, offsets, weights)
