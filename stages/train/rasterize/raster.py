"""What a rasterisation returns, and the one function that all backends answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

import torch
from torch import Tensor


@dataclass
class Raster:
    """Blended images of one view. Sums are over splats, front to back, with weights w = alpha * transmittance (with `layer`,
    those of `features` and `normal` are shared out by alpha within a layer).

    Only the images carry gradients. Distances are in world units; pixels outside `pixel_mask` are 0 everywhere.
    """

    features: Tensor  # [H, W, C] sum of w * feature (not divided by alpha)
    alpha: Tensor  # [H, W] sum of w, 0..1
    normal: Tensor  # [H, W, 3] sum of w * unit normal, world axes, facing the camera
    depth_expected: Tensor  # [H, W] sum of w * camera z of the ray-splat intersection (not divided)
    depth_median: Tensor  # [H, W] camera z of the splat that takes the transmittance to 1/2 or below; 0 where none does
    distortion: Tensor  # [H, W] sum over pairs i < j of w_i w_j (z_i - z_j)^2 (2DGS code's form on plain z) [distance^2]
    screen_gradient: Tensor  # [N] filled by backward: norm of the per-axis sums over pixels of |dL/d centre| [1/px]
    visible: Tensor  # [N] largest blending weight over the pixels (with `layer`, as if alone in its layer), 0 where unseen
    radii: Tensor  # [N] half the larger side of the projected bounding box [px]; 0 where culled


BACKENDS = ("cpu", "reference", "cuda")


def rasterize(
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
    backend: str = "cpu",
    near: float | None = None,
    pixel_mask: Tensor | None = None,  # [H, W]
    screen_filter: int = 1,
    layer: float = 0.0,
) -> Raster:
    """Blend perspective-correct 2D Gaussians (2DGS, Huang et al. 2024, Sec. 4) into images of one pinhole view.

    Args:
        means: centres, world units. [N, 3]
        quats: wxyz, normalised inside; columns of the rotation are t_u, t_v, normal. [N, 4]
        scales: sigma along t_u and t_v, linear, > 0, world units. [N, 2]
        opacities: peak opacity, 0..1. [N]
        features: any number of channels, C = 0 included. [N, C]
        world_to_camera: rigid, OpenCV axes; carries no gradient. [4, 4]
        intrinsics: fx, fy, cx, cy in pixels, pixel centres at +0.5, no skew; carries no gradient. [3, 3]
        backend: "cpu" (numba, float32), "reference" (torch, in the inputs' dtype: the definition), "cuda" (gsplat).
        near: splats and intersections nearer than this camera z are dropped; None: `NEAR_FRACTION` of the median depth.
        pixel_mask: True where pixels are wanted; tiles without any are skipped. [H, W] bool
        screen_filter: rho = min(object space, screen space); 1 is the low-pass filter of 2DGS and gsplat (sigma 0.71 px),
            k one k times as narrow (sigma 0.71 / k px), 0 none: object space only.
        layer: > 0, world units: splats that a pixel's ray meets within this depth of the first one belong to one surface, and
            `features` and `normal` show their mean weighted by alpha, instead of the nearer ones hiding the others. On a
            curved surface the nearer ones are those that lean towards the camera, so blending front to back alone turns
            every normal towards it (by 0.7 degrees for splats a pixel apart on an object of 120 pixels). The other images
            are blended front to back all the same; a pixel ends only behind a layer, though, not within it.

    Raises:
        ValueError: a shape, a backend or the intrinsics are not as stated.
    """
    check_inputs(means, quats, scales, opacities, features, world_to_camera, intrinsics, width, height, pixel_mask)
    if near is not None and not near > 0:
        raise ValueError(f"near must be positive, got {near}")
    if not 0 <= layer < float("inf"):
        raise ValueError(f"layer must be a depth >= 0, got {layer}")
    if screen_filter < 0 or screen_filter != int(screen_filter):
        raise ValueError(f"screen_filter must be 0, 1, 2, ..., got {screen_filter}")
    if backend not in BACKENDS:
        raise ValueError(f"unknown rasteriser backend {backend!r}; there are {', '.join(BACKENDS)}")
    module = import_module(f".{backend}", __package__)
    run: Callable[..., Raster] = getattr(module, f"rasterize_{backend}")
    arguments = (means, quats, scales, opacities, features, world_to_camera, intrinsics, int(width), int(height))
    return run(*arguments, near=near, pixel_mask=pixel_mask, screen_filter=screen_filter, layer=layer)


def check_inputs(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    features: Tensor,
    world_to_camera: Tensor,
    intrinsics: Tensor,
    width: int,
    height: int,
    pixel_mask: Tensor | None,
) -> None:
    """Raise ValueError naming the first argument whose shape or type is not as `rasterize` states."""
    count = means.shape[0]
    expected = {
        "means": (means, (count, 3)),
        "quats": (quats, (count, 4)),
        "scales": (scales, (count, 2)),
        "opacities": (opacities, (count,)),
        "features": (features, (count, *features.shape[1:2])),
        "world_to_camera": (world_to_camera, (4, 4)),
        "intrinsics": (intrinsics, (3, 3)),
    }
    for name, (tensor, shape) in expected.items():
        if tuple(tensor.shape) != shape or (name == "features" and tensor.ndim != 2):
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}, expected {shape or '[N, C]'}")
        if not tensor.is_floating_point():
            raise ValueError(f"{name} has dtype {tensor.dtype}, expected a floating type")
    if width < 1 or height < 1:
        raise ValueError(f"image is {width} x {height} pixels")
    if not (float(intrinsics[0, 0]) > 0 and float(intrinsics[1, 1]) > 0) or float(intrinsics[0, 1]) != 0:
        raise ValueError(f"intrinsics need positive fx, fy and no skew, got {intrinsics.tolist()}")
    if pixel_mask is not None and (tuple(pixel_mask.shape) != (height, width) or pixel_mask.dtype != torch.bool):
        raise ValueError(f"pixel_mask is {tuple(pixel_mask.shape)} {pixel_mask.dtype}, expected bool ({height}, {width})")
