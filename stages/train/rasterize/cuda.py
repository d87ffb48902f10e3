"""The rasteriser on an NVIDIA GPU: gsplat's 2DGS kernels behind the same function.

Where gsplat's definition differs from `reference`, its own stands: alpha is capped at 0.999 instead of 0.99; a splat is cut by
whole tiles at about 3.3 sigma, so up to 0.011 of its peak is added at its rim; the depth of a splat is its centre's, not its
intersection's; the screen-space kernel sits on the middle of the outline's box. `screen_gradient` is what gsplat's own
densification reads, and `visible` is an upper bound: the opacity of every splat inside the image.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import torch
from torch import Tensor

from pipeline.errors import UserError

from .constants import NEAR_FRACTION, SCREEN_INVERSE_VARIANCE
from .layers import layer_numbers, layer_weights
from .raster import Raster

TILE = 16  # the only size gsplat tests
GSPLAT_ALPHA_MAX = 0.999  # its cap of one splat's opacity at one pixel
CHANNELS = (1, 2, 3, 4, 8, 16, 32, 64, 128, 256, 512)  # what gsplat compiles for


def gsplat_functions() -> SimpleNamespace:
    """gsplat's functions, or UserError saying what is missing. They compile themselves at first use, for minutes."""
    where = "device cuda"
    if not torch.cuda.is_available():
        fault = "PyTorch sees no CUDA device" + ("" if torch.version.cuda else " (this is its CPU-only build)")
        raise UserError(where, fault, "use --device cpu, or install a CUDA build of torch and a driver for it")
    if find_spec("gsplat") is None:
        raise UserError(where, "gsplat is not installed", "pip install 'polarfield[cuda]', or use --device cpu")
    if find_spec("gsplat.csrc") is None:  # no prebuilt kernels in the package: it will call nvcc
        home = os.environ.get("CUDA_HOME") or os.environ.get("CUDA_PATH") or "/usr/local/cuda"
        compiler = (Path(home) / "bin" / "nvcc").is_file() or shutil.which("nvcc")
        for tool, found in (("nvcc, of the CUDA toolkit,", compiler), ("ninja", shutil.which("ninja"))):
            if not found:
                needed = (
                    f"gsplat compiles its kernels with it at first use: install it (CUDA {torch.version.cuda}; set CUDA_HOME)"
                )
                raise UserError(where, f"{tool} is missing", f"{needed}, or use --device cpu")
    from gsplat.cuda import _wrapper

    names = (
        "fully_fused_projection_2dgs",
        "isect_tiles",
        "isect_offset_encode",
        "rasterize_to_pixels_2dgs",
        "rasterize_to_indices_in_range_2dgs",
    )
    return SimpleNamespace(**{name: getattr(_wrapper, name) for name in names})


def padded(colours: Tensor) -> Tensor:
    """Zeros before the last channel up to a count that gsplat compiles for. [1, N, A] -> [1, N, A']

    gsplat pads too, but with uninitialised memory, whose NaN times a zero cotangent invalidates the gradient of alpha.
    """
    count = colours.shape[-1]
    channels = next((size for size in CHANNELS if size >= count), None)
    if channels is None:
        raise ValueError(f"gsplat blends at most {CHANNELS[-1]} channels, two of them for depth; got {count - 2}")
    zeros = colours.new_zeros(*colours.shape[:-1], channels - count)
    return torch.cat((colours[..., :-1], zeros, colours[..., -1:]), -1)


def tile_mask(pixel_mask: Tensor) -> Tensor:
    """Tiles with a wanted pixel. [H, W] bool -> [1, rows, columns] bool"""
    pooled = torch.nn.functional.max_pool2d(pixel_mask[None].float(), TILE, ceil_mode=True)
    return pooled > 0


def enlarged(intrinsics: Tensor, pixel_mask: Tensor | None, factor: int) -> tuple[Tensor, Tensor | None]:
    """Lens and mask of an image `factor` times as large whose every `factor`-th pixel centre, from the first, is an old one."""
    lens = intrinsics.clone()
    lens[:2, :2] *= factor
    lens[:2, 2] = factor * (intrinsics[:2, 2] - 0.5) + 0.5
    if pixel_mask is None:
        return lens, None
    mask = pixel_mask.new_zeros(factor * pixel_mask.shape[0], factor * pixel_mask.shape[1])
    mask[::factor, ::factor] = pixel_mask
    return lens, mask


def thinned(raster: Raster, factor: int) -> Raster:
    """Every `factor`-th pixel of an enlarged raster; gradients and radii in the small image's pixels."""
    images = ("features", "alpha", "normal", "depth_expected", "depth_median", "distortion")
    small = {name: getattr(raster, name)[::factor, ::factor] for name in images}
    # The gradient arrives in `backward`, in the tensor that `raster` holds: a view of it would miss the factor, so the
    # densification's measure stays in enlarged pixels here. It is only ever compared with itself.
    return replace(raster, **small, radii=raster.radii / factor)


def layered_image(
    gsplat: SimpleNamespace,
    projected: tuple[Tensor, ...],  # centres and shift [1, N, 2], transforms to splats [1, N, 3, 3], opacities [1, N], in
    # the order centres, transforms, opacities, shift
    attributes: Tensor,  # [N, A]
    depths: Tensor,  # [N] camera z of the centres
    places: tuple[Tensor, Tensor, Tensor],  # gsplat's tile offsets and splat list, wanted pixels [H, W]
    layer: float,
) -> Tensor:
    """The attributes blended by layers (`layers`). [H, W, A]

    The shift, zero, takes up the gradient by the splats' places in the image. gsplat stops a pixel where
    `TRANSMITTANCE_STOP` is reached, even within a layer.
    """
    offsets, splat_ids, wanted = places
    height, width = wanted.shape
    untouched = attributes.new_ones(1, height, width)
    every = 1 << 30  # batches of splats: all of them
    pairs = gsplat.rasterize_to_indices_in_range_2dgs(
        0, every, untouched, *(t.detach() for t in projected[:3]), width, height, TILE, offsets, splat_ids
    )
    splat, pixel = pairs[0], pairs[1]
    kept = wanted.reshape(-1)[pixel]
    splat, pixel = splat[kept], pixel[kept]
    centres, transforms, opacities, shift = (t[0][splat] for t in projected)
    x = pixel % width + 0.5 - shift[:, 0]
    y = torch.div(pixel, width, rounding_mode="floor") + 0.5 - shift[:, 1]
    # The transform's rows are image x, y times depth, and depth, linear in (u, v, 1): the pixel's column and line are two
    # planes, whose common line is the splat's point.
    plane_x = x[:, None] * transforms[:, 2] - transforms[:, 0]
    plane_y = y[:, None] * transforms[:, 2] - transforms[:, 1]
    point = torch.linalg.cross(plane_x, plane_y)
    u, v = point[:, 0] / point[:, 2], point[:, 1] / point[:, 2]
    rho_object = u * u + v * v
    rho_screen = SCREEN_INVERSE_VARIANCE * ((x - centres[:, 0]) ** 2 + (y - centres[:, 1]) ** 2)
    alpha = (opacities * torch.exp(-0.5 * torch.minimum(rho_object, rho_screen))).clamp(max=GSPLAT_ALPHA_MAX)
    with torch.no_grad():
        z = transforms[:, 2, 0] * u + transforms[:, 2, 1] * v + transforms[:, 2, 2]
        z = torch.where(rho_screen < rho_object, depths[splat], z)
        number, counted = layer_numbers(alpha, z, pixel, layer)
    weight, _ = layer_weights(alpha * counted, number, pixel)
    image = attributes.new_zeros(height * width, attributes.shape[1])
    return image.index_add(0, pixel, weight[:, None] * attributes[splat]).reshape(height, width, -1)


def rasterize_cuda(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    scales: Tensor,  # [N, 2]
    opacities: Tensor,  # [N]
    features: Tensor,  # [N, C]
    world_to_camera: Tensor,  # [4, 4]
    intrinsics: Tensor,  # [3, 3]
    width: int,
    height: int,
    *,
    near: float | None = None,
    pixel_mask: Tensor | None = None,  # [H, W]
    screen_filter: int = 1,
    layer: float = 0.0,
) -> Raster:
    """`rasterize` by gsplat, in float32, on the device of `means`.

    With `layer`, gsplat names the splats of every pixel and torch blends them (`layered_image`). gsplat's filter is fixed
    in pixels, so a narrower one is had by enlarging the image (`enlarged`).
    """
    if not screen_filter:
        raise ValueError("gsplat always applies the screen-space filter")
    if screen_filter > 1:
        lens, mask = enlarged(intrinsics, pixel_mask, screen_filter)
        size = (screen_filter * width, screen_filter * height)
        splats = (means, quats, scales, opacities, features)
        large = rasterize_cuda(*splats, world_to_camera, lens, *size, near=near, pixel_mask=mask, layer=layer)
        return thinned(large, screen_filter)
    gsplat = gsplat_functions()
    means, quats, scales, opacities, features = (t.float() for t in (means, quats, scales, opacities, features))
    camera = world_to_camera.detach().to(means)
    z_centre = (means.detach() @ camera[2, :3]) + camera[2, 3]
    front = z_centre[z_centre > 0]
    z_ref = float(front.median()) if len(front) else 1.0  # one host synchronisation a call
    near = NEAR_FRACTION * z_ref if near is None else near
    thickness = torch.ones_like(scales[:, :1])  # the third axis is not used
    projected = gsplat.fully_fused_projection_2dgs(
        means, quats, torch.cat((scales, thickness), 1), camera[None], intrinsics.detach().to(means)[None], width, height,
        near_plane=near,
    )  # fmt: skip
    radii, means2d, depths, transforms, normals = projected  # [1, N, ...] each

    rows, columns = -(-height // TILE), -(-width // TILE)
    _, pairs, splat_ids = gsplat.isect_tiles(means2d, radii, depths, TILE, columns, rows, n_images=1)
    offsets = gsplat.isect_offset_encode(pairs, 1, columns, rows).reshape(1, rows, columns)
    spread = (depths - z_ref)[..., None] ** 2
    colours = padded(torch.cat((features[None], spread, depths[..., None]), -1))  # gsplat's median reads the last one
    densify = torch.zeros_like(means2d, requires_grad=True)
    screen_gradient = torch.zeros_like(opacities)

    def keep_norm(gradient: Tensor) -> None:
        screen_gradient.copy_(gradient[0].norm(dim=-1))

    densify.register_hook(keep_norm)
    blended, alphas, normal, _, median = gsplat.rasterize_to_pixels_2dgs(
        means2d, transforms, colours, opacities[None], normals, densify, width, height, TILE, offsets, splat_ids,
        masks=None if pixel_mask is None else tile_mask(pixel_mask.to(means.device)),
    )  # fmt: skip

    wanted = torch.ones_like(alphas[0]) if pixel_mask is None else pixel_mask.to(alphas)[..., None]
    blended, alphas, normal, median = (torch.where(wanted > 0, image[0], 0.0) for image in (blended, alphas, normal, median))
    channels = features.shape[1]
    shown = blended[..., :channels]
    if layer > 0:
        attributes = torch.cat((features, normals[0]), 1)
        places = (offsets, splat_ids, wanted[..., 0] > 0)
        image = layered_image(gsplat, (means2d, transforms, opacities[None], densify), attributes, depths[0], places, layer)
        shown, normal = image.split((channels, 3), -1)
    alpha, expected = alphas[..., 0], blended[..., -1]
    moment1 = expected - z_ref * alpha
    half_reached = (alpha >= 0.5).to(median)  # gsplat gives the last splat's depth where half is never reached
    inside = (radii[0] > 0).all(-1)
    return Raster(
        features=shown,
        alpha=alpha,
        normal=normal @ camera[:3, :3],
        depth_expected=expected,
        depth_median=median[..., 0] * half_reached,
        distortion=alpha * blended[..., channels] - moment1**2,
        screen_gradient=screen_gradient,
        visible=torch.where(inside, opacities.detach(), 0.0),
        radii=radii[0].amax(-1).to(opacities.dtype),
    )
