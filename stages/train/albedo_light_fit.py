"""The albedo-illumination scale in closed form after the last step, by least squares over linear radiance.

The losses are robust and of display-encoded radiance: they fit medians. Mirrored light is skewed, dark mostly and bright in
few places, and a model blurs it by splats' spacing and facets: a median of what is blurred lies below the mean, and the whole
light is learnt too dark by as much (a teapot's, of r = 0.32, by 4, 7 and 8 % in red, green, blue). Least squares of linear
radiance fit means, which blur leaves alone. Steps after it would only go back to the medians, so it comes last.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch

from pipeline.optics import fresnel
from pipeline.optics.stokes import surface_pattern

from .render_view import Rendered
from .scene import Scene
from .splats.gaussians import logit
from .views.source_views import Mode
from .views.view import View

FEWEST_VIEWS = 4  # whose disagreement says how much to believe
MOST_ALBEDO = 0.99  # that a scaled albedo comes to
MOST = 1.2  # factor: medians of what is blurred were up to a tenth off; what asks for more is not blur


class ScaleFit:
    """Normal equations of measured = a mirrored + b diffuse, per view and colour channel.

    Attributes:
        squares, products: those of the views so far. [V, 3, 2, 2], [V, 3, 2]
    """

    def __init__(self) -> None:
        self.squares = torch.zeros(0, 3, 2, 2, dtype=torch.float64)
        self.products = torch.zeros(0, 3, 2, dtype=torch.float64)

    @torch.no_grad()
    def add(self, view: View, rendered: Rendered, mode: Mode, scene: Scene) -> None:
        """Take in a training view as it was rendered for a step."""
        mirrored, diffuse = parts(view, rendered)
        target = view.target
        if mode == "polarisers" and scene.bank is not None:
            mirrored, diffuse = (scene.bank.intensity(x, view.camera.name)[:, None] for x in (mirrored, diffuse))
            target = 2 * target[:, :1]
        columns = torch.stack([mirrored[:, : target.shape[1]], diffuse[:, : target.shape[1]]], -1).double()  # [P, S, 3, 2]
        weight = weights(view, rendered).double()[:, None, None]
        weighted = columns * weight[..., None]
        measured = torch.where(weight > 0, target, 0.0).double()  # what has no weight may be NaN
        square = torch.einsum("pscj,psck->cjk", weighted, columns)
        product = torch.einsum("pscj,psc->cj", weighted, measured)
        self.squares = torch.cat([self.squares.to(square), square[None]])  # on the device: nothing waits for it
        self.products = torch.cat([self.products.to(product), product[None]])

    def scales(self) -> tuple[torch.Tensor, torch.Tensor]:
        """(light [3], diffuse [3]): factors of mirrored and of diffuse light, drawn to 1 as far as the views disagree."""
        one = torch.ones(3, dtype=torch.float64)
        if len(self.squares) < FEWEST_VIEWS:
            return one, one
        squares, products = self.squares.cpu(), self.products.cpu()
        whole = solved(squares.sum(0), products.sum(0))
        others = solved(squares.sum(0) - squares, products.sum(0) - products)
        count = len(others)
        variance = (count - 1) / count * ((others - others.mean(0)) ** 2).sum(0)  # the jackknife's
        away = whole - 1
        kept = (1 - variance / (away**2).clamp_min(1e-12)).clamp(0, 1)
        light, diffuse = (1 + kept * away).clamp(1 / MOST, MOST).nan_to_num(1.0).unbind(-1)
        return light, diffuse

    @torch.no_grad()
    def apply(self, scene: Scene) -> tuple[torch.Tensor, torch.Tensor]:
        """Scale the scene's light, albedo and traced light in place; returns `scales`."""
        light, diffuse = self.scales()
        raw, albedo = scene.environment.raw, scene.model["albedo"]
        raw.add_(torch.log(light).to(raw))
        scaled = torch.sigmoid(albedo) * (diffuse / light).to(albedo)
        albedo.copy_(logit(scaled.clamp(1e-6, MOST_ALBEDO)))
        # What the object sends to itself is mostly diffuse.
        k = diffuse.to(albedo)
        for name, traced in scene.occlusion.items():
            scene.occlusion[name] = replace(traced, bounced=k * traced.bounced, seen=k * traced.seen)
        if scene.splat_occlusion is not None:
            scene.splat_occlusion = replace(scene.splat_occlusion, bounced=k * scene.splat_occlusion.bounced)
        return light, diffuse

    def state(self) -> dict[str, Any]:
        """Everything a resume needs."""
        return {"squares": self.squares.clone(), "products": self.products.clone()}

    def load(self, state: dict[str, Any]) -> None:
        """Take over a saved state."""
        self.squares, self.products = state["squares"], state["products"]


def solved(squares: torch.Tensor, products: torch.Tensor) -> torch.Tensor:
    """Least-squares factors [..., 3, 2] of normal equations [..., 3, 2, 2] and [..., 3, 2]; nan where they are singular."""
    (p, q), (_, r) = (row.unbind(-1) for row in squares.unbind(-2))
    u, v = products.unbind(-1)
    determinant = p * r - q * q
    divisor = torch.where(determinant > 1e-9 * p * r, determinant, torch.nan)
    return torch.stack([r * u - q * v, p * v - q * u], -1) / divisor[..., None]


def parts(view: View, rendered: Rendered) -> tuple[torch.Tensor, torch.Tensor]:
    """Stokes radiance [P, 3, 3] of mirrored light and of light from the body, times opacity; their sum is the rendering's."""
    g, shaded = rendered.gbuffer, rendered.shaded
    cosine = (g.normal * view.view_direction).sum(-1).clamp(0, 1)
    around = torch.stack(surface_pattern(g.normal, view.frame_x, view.frame_y), 1)
    share = torch.cat([torch.ones_like(cosine)[:, None], fresnel.diffuse_polarisation(cosine, g.ior)[:, None] * around], 1)
    body = g.alpha[:, None, None] * share[..., None] * shaded.diffuse[:, None]
    return rendered.stokes - body, body


def weights(view: View, rendered: Rendered) -> torch.Tensor:
    """Weight [P] of a view's pixels: of wholly covered ones, falling to 0 where the surface turns away.

    There normals are blurred most, and Fresnel reflectance rises steeply.
    """
    g = rendered.gbuffer
    facing = (g.normal * view.view_direction).sum(-1).clamp(0, 1)
    return view.colour_weight * view.inside * facing
