"""One view of the model: cull, rasterise the attributes, divide by opacity once, shade, polarise."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from pipeline.lighting import LightField, Occlusion, Shaded, shade

from .data import View
from .model import Splats, unit
from .rasterize import Raster, rasterize

BACK_FACING = 0.1  # cosine below which a splat has turned its outer side away: half of it reaches past the horizon
SCREEN_FILTER = 2  # half of gsplat's low-pass filter, which widens every outline by a pixel: 0.5 to 1 degree of normal error
LAYER = 4.0  # median splat sigmas of depth within which splats are one surface: two pixels, when they are 0.9 apart
LEAST_ALPHA = 1e-3  # opacity below which a pixel's attributes are noise over noise: they then fade to zero instead


@dataclass(frozen=True)
class GBuffer:
    """Attributes of P pixels, divided by opacity: normal [P, 3] (unit, outward), albedo [P, 3], roughness, ior, alpha [P];
    extra [P, C]; alpha_image [H, W]; the raster itself; rows: indices of the splats that were drawn."""

    normal: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    ior: torch.Tensor
    extra: torch.Tensor
    alpha: torch.Tensor
    alpha_image: torch.Tensor
    raster: Raster
    rows: torch.Tensor


@dataclass(frozen=True)
class Rendered:
    """Stokes radiance [P, 3, 3] times opacity, with the G-buffer and the shading that made it."""

    stokes: torch.Tensor
    gbuffer: GBuffer
    shaded: Shaded
    splats: Splats


def rasterise_view(
    splats: Splats, view: View, pixels: torch.Tensor, backend: str, extra: torch.Tensor | None = None
) -> GBuffer:
    """G-buffer of a view at flat pixel indices [P]; `extra` [N, C] per-splat values are blended alongside."""
    height, width = view.size
    rows = torch.nonzero(_faces(splats, view))[:, 0]
    columns = [splats.normals, splats.albedo, splats.roughness[:, None], splats.ior[:, None]]
    features = torch.cat(columns if extra is None else [*columns, extra], -1)[rows]
    raster = _rasterised(splats, rows, features, view, backend)
    alpha = raster.alpha.reshape(-1)[pixels]
    values = raster.features.reshape(height * width, -1)[pixels] / alpha.clamp_min(LEAST_ALPHA)[:, None]
    return GBuffer(
        normal=unit(values[:, :3]),
        albedo=values[:, 3:6],
        roughness=values[:, 6],
        ior=values[:, 7],
        extra=values[:, 8:],
        alpha=alpha,
        alpha_image=raster.alpha,
        raster=raster,
        rows=rows,
    )


@torch.no_grad()
def back_normals(splats: Splats, view: View, backend: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Outward normals [P, 3] and opacity [P] of the splats that turn their backs, at a view's counting pixels.

    They are what an opening shows once no outer side is in the way: see `data.opening_pixels`.
    """
    rows = torch.nonzero(~_faces(splats, view))[:, 0]
    raster = _rasterised(splats, rows, splats.normals[rows], view, backend)
    return unit(raster.features.reshape(-1, 3)[view.pixels]), raster.alpha.reshape(-1)[view.pixels]


@torch.no_grad()
def _faces(splats: Splats, view: View) -> torch.Tensor:
    """Which splats [N] do not show the view their inner side."""
    centre = -view.world_to_camera[:3, :3].T @ view.world_to_camera[:3, 3]
    towards = centre - splats.means
    return (splats.normals * towards).sum(-1) > BACK_FACING * towards.norm(dim=-1)


def _rasterised(splats: Splats, rows: torch.Tensor, features: torch.Tensor, view: View, backend: str) -> Raster:
    """The splats `rows` with their features [R, C] in a view."""
    height, width = view.size
    scales = splats.scales.detach()
    return rasterize(
        splats.means[rows],
        splats.quaternions[rows],
        splats.scales[rows],
        splats.opacities[rows],
        features,
        view.world_to_camera,
        view.intrinsics,
        width,
        height,
        backend=backend,
        screen_filter=SCREEN_FILTER,
        layer=LAYER * float(scales.median()) if len(scales) else 0.0,
    )


def render_view(
    splats: Splats,
    view: View,
    light: LightField,
    *,
    backend: str = "cpu",
    fresnel: str = "exact",
    mirror: str = "split",
    occlusion: Occlusion | None = None,
) -> Rendered:
    """Stokes image of a view at its counting pixels."""
    g = rasterise_view(splats, view, view.pixels, backend)
    # An empty pixel has a zero normal: any finite one will do, its opacity is 0.
    normal = torch.where(g.alpha[:, None] > 0, g.normal, view.view_direction)
    shaded = shade(
        normal,
        view.view_direction,
        g.albedo,
        g.roughness,
        g.ior,
        view.frame_x,
        view.frame_y,
        light,
        occlusion=occlusion,
        fresnel=fresnel,
        mirror=mirror if fresnel == "exact" else "split",
    )
    return Rendered(shaded.stokes * g.alpha[:, None, None], g, shaded, splats)
