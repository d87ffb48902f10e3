"""One view of the model: cull, rasterise the attributes, divide by opacity once, shade, polarise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from pipeline.shading import LightField, Occlusion, Shaded, shade

from .indirect.pixel_light import PixelLight
from .pixel_attributes import pixel_attributes
from .rasterize import Raster, rasterize
from .splats.gaussians import Splats, unit
from .splats.taken_rows import cosines, taken_rows
from .views.view import View

GRAZING = 0.1  # cosine below which a splat fades: half of it reaches past the horizon, and takes its normal there
LEARNT_FROM = 0.05  # cosine from which it counts while training: what is seen edge-on would bend to please single pixels
SHOWN_FROM = 0.0  # the same in what is written: straight sides have nothing else in the last pixel before their outline
SCREEN_FILTER = 2  # half of gsplat's low-pass filter, which widens every outline by a pixel: 0.5 to 1 degree of normal error
LAYER = 4.0  # median splat sigmas of depth within which splats are one surface: two pixels, when they are 0.9 apart
SAMPLES = 4  # a side, for a pixel's mean normal: with 2, rims a pixel wide and outlines lose another 0.1 degree
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
    splats: Splats,
    view: View,
    pixels: torch.Tensor,
    backend: str,
    extra: torch.Tensor | None = None,
    faintest: float = LEARNT_FROM,
) -> GBuffer:
    """G-buffer of a view.

    Args:
        splats: the Gaussians, N of them.
        view: camera and size.
        pixels: flat indices. [P]
        backend: rasteriser (`rasterize.BACKENDS`).
        extra: per-splat values that are blended alongside. [N, C]
        faintest: LEARNT_FROM or SHOWN_FROM.

    Returns:
        Attributes at the pixels, divided by opacity; where opacity is below LEAST_ALPHA they fade to 0.
    """
    rows, shown = _facing(splats, view, faintest)
    raster = _rasterised(splats, rows, shown, view, backend, extra)
    normal, albedo, roughness, ior, more, alpha = pixel_attributes(raster.features, raster.alpha, pixels)
    return GBuffer(normal, albedo, roughness, ior, more, alpha, raster.alpha, raster, rows)


@torch.no_grad()
def mean_normals(splats: Splats, view: View, backend: str, openings: bool) -> torch.Tensor:
    """Normals [P, 3], unit, averaged over SAMPLES x SAMPLES places in each of a view's counting pixels; 0 where nothing is.

    A pixel's colour is the mean over its area, and so is the normal of what it shows: that at its centre is off by two
    thirds of a degree on a true surface. With `openings`, where no outer side is in the way of a splat that turns its
    back, its outward normal counts, which faces away from the camera: see `views.opening_pixels`.
    """
    total = None
    for sign in (1, -1) if openings else (1,):
        rows, there = _facing(splats, view, SHOWN_FROM, sign)
        raster = _rasterised(splats, rows, there, view, backend, finer=SAMPLES)
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
    return _rasterised(splats, *_facing(splats, view, SHOWN_FROM, -1), view, backend).alpha


@torch.no_grad()
def _facing(splats: Splats, view: View, faintest: float, side: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Indices [R] of the splats that turn their outer side (-1: the inner one) to a view by a cosine above `faintest`, and how
    far they count there, 0 there to 1 at GRAZING [R]."""
    centre = -view.world_to_camera[:3, :3].T @ view.world_to_camera[:3, 3]
    cosine = side * cosines(splats, centre)
    rows = torch.nonzero(cosine > faintest)[:, 0]
    return rows, ((cosine[rows] - faintest) / (GRAZING - faintest)).clamp_max(1)


def _rasterised(
    splats: Splats,
    rows: torch.Tensor,
    shown: torch.Tensor,
    view: View,
    backend: str,
    extra: torch.Tensor | None = None,
    finer: int = 1,
) -> Raster:
    """The splats `rows` in a view, `finer` times as large, their opacities times `shown`, with features [H, W, 8 + C]: normal,
    albedo, roughness, IoR and `extra` [N, C].

    The low-pass filter is at least the usual one on the larger image, which needs no more."""
    height, width = view.size
    lens = view.intrinsics.clone()
    lens[:2] *= finer
    widths = splats.scales.detach()[:, 0]
    means, quaternions, scales, opacities, features = taken_rows(splats, rows, extra)
    return rasterize(
        means,
        quaternions,
        scales,
        opacities * shown,
        features,
        view.world_to_camera,
        lens,
        finer * width,
        finer * height,
        backend=backend,
        screen_filter=max(1, SCREEN_FILTER // finer),
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
    faintest: float = LEARNT_FROM,
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
        faintest: LEARNT_FROM or SHOWN_FROM.
    """
    g = rasterise_view(splats, view, view.pixels, backend, extra, faintest)
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
