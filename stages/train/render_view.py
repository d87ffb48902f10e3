"""One view of the model: cull, rasterise the attributes, divide by opacity once, shade, polarise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from pipeline.shading import LightField, Occlusion, Shaded, shade

from .indirect.pixel_light import PixelLight
from .pixel_attributes import pixel_attributes
from .rasterize import Raster, rasterize
from .splats.activation import facing, taken_rows
from .splats.gaussians import Splats, unit
from .views.view import View

BACK_FACING = 0.1  # cosine below which a splat has turned its outer side away: half of it reaches past the horizon
SCREEN_FILTER = 2  # half of gsplat's low-pass filter, which widens every outline by a pixel: 0.5 to 1 degree of normal error
LAYER = 4.0  # median splat sigmas of depth within which splats are one surface: two pixels, when they are 0.9 apart
SAMPLES = SCREEN_FILTER  # a side, for a pixel's mean normal: the filter is then the usual one on the larger image
SHOWN = 0.5  # opacity from which a place shows what is there: normals exist where transmittance falls to one half


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
    """G-buffer of a view.

    Args:
        splats: the Gaussians, N of them.
        view: camera and size.
        pixels: flat indices. [P]
        backend: rasteriser (`rasterize.BACKENDS`).
        extra: per-splat values that are blended alongside. [N, C]

    Returns:
        Attributes at the pixels, divided by opacity; where opacity is below LEAST_ALPHA they fade to 0.
    """
    rows = torch.nonzero(_faces(splats, view))[:, 0]
    raster = _rasterised(splats, rows, view, backend, extra)
    normal, albedo, roughness, ior, more, alpha = pixel_attributes(raster.features, raster.alpha, pixels)
    return GBuffer(normal, albedo, roughness, ior, more, alpha, raster.alpha, raster, rows)


@torch.no_grad()
def mean_normals(splats: Splats, view: View, backend: str, openings: bool) -> torch.Tensor:
    """Normals [P, 3], unit, averaged over SAMPLES x SAMPLES places in each of a view's counting pixels; 0 where nothing is.

    A pixel's colour is the mean over its area, and so is the normal of what it shows: that at its centre is off by two
    thirds of a degree on a true surface. With `openings`, where no outer side is in the way of a splat that turns its
    back, its outward normal counts, which faces away from the camera: see `views.opening_pixels`.
    """
    faces = _faces(splats, view)
    sides = [faces, ~faces] if openings else [faces]
    total = None
    for side in sides:
        rows = torch.nonzero(side)[:, 0]
        raster = _rasterised(splats, rows, view, backend, finer=SAMPLES)
        shown = unit(raster.features[..., :3]) * (raster.alpha > SHOWN)[..., None]
        total = shown if total is None else torch.where((total != 0).any(-1, keepdim=True), total, shown)
    assert total is not None
    height, width = view.size
    pooled = total.reshape(height, SAMPLES, width, SAMPLES, 3).mean((1, 3))
    return unit(pooled.reshape(-1, 3)[view.pixels])


@torch.no_grad()
def inner_coverage(splats: Splats, view: View, backend: str) -> torch.Tensor:
    """How far splats that surely show a view their inner side cover its pixels [H, W].

    Through an opening one looks at the back of a surface, which is as opaque as its front.
    """
    turned = replace(splats, normals=-splats.normals)
    rows = torch.nonzero(_faces(turned, view))[:, 0]
    return _rasterised(splats, rows, view, backend).alpha


@torch.no_grad()
def _faces(splats: Splats, view: View) -> torch.Tensor:
    """Which splats [N] do not show the view their inner side."""
    centre = -view.world_to_camera[:3, :3].T @ view.world_to_camera[:3, 3]
    return facing(splats, centre, BACK_FACING)


def _rasterised(
    splats: Splats, rows: torch.Tensor, view: View, backend: str, extra: torch.Tensor | None = None, finer: int = 1
) -> Raster:
    """The splats `rows` in a view, `finer` (1 or SCREEN_FILTER) times as large, with features [H, W, 8 + C]: normal, albedo,
    roughness, IoR and `extra` [N, C]."""
    height, width = view.size
    lens = view.intrinsics.clone()
    lens[:2] *= finer
    widths = splats.scales.detach()[:, 0]
    return rasterize(
        *taken_rows(splats, rows, extra),
        view.world_to_camera,
        lens,
        finer * width,
        finer * height,
        backend=backend,
        screen_filter=SCREEN_FILTER // finer,
        layer=LAYER * float(widths.median()) if len(widths) else 0.0,
    )


def render_view(
    splats: Splats,
    view: View,
    light: LightField,
    *,
    backend: str = "cpu",
    fresnel: str = "exact",
    mirror: str = "split",
    occlusion: Occlusion | Callable[[GBuffer], Occlusion] | None = None,
    extra: torch.Tensor | None = None,
) -> Rendered:
    """Stokes image of a view at its P counting pixels, differentiable in splats and light.

    Args:
        splats: the Gaussians.
        view: camera, size, counting pixels and their Stokes frames.
        light: prefiltered environment.
        backend: rasteriser (`rasterize.BACKENDS`).
        fresnel, mirror: shading model, as in `pipeline.shading.shade` (Schlick always has the split sum).
        occlusion: what the object takes from and adds to the light at the pixels, or what tells it from the G-buffer; None:
            nothing.
        extra: per-splat values that are blended alongside. [N, C]
    """
    g = rasterise_view(splats, view, view.pixels, backend, extra)
    # An empty pixel has a zero normal: any finite one will do, its opacity is 0.
    normal = torch.where(g.alpha[:, None] > 0, g.normal, view.view_direction)
    light_here = occlusion(g) if callable(occlusion) else occlusion
    shaded = shade(
        normal,
        view.view_direction,
        g.albedo,
        g.roughness,
        g.ior,
        view.frame_x,
        view.frame_y,
        light,
        occlusion=light_here.under(normal, g.extra) if isinstance(light_here, PixelLight) else light_here,
        fresnel=fresnel,
        mirror=mirror if fresnel == "exact" else "split",
    )
    return Rendered(shaded.stokes * g.alpha[:, None, None], g, shaded, splats)
