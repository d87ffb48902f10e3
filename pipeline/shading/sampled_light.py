"""Shading under light from single directions, one point's not the next's: lamps that stand near, and their shadows."""

from __future__ import annotations

import torch

from pipeline.optics import fresnel, microfacet
from pipeline.optics.stokes import surface_pattern

from . import limits
from .light_tree_plain import Leaves, lobe_weights
from .prefilter_kernels import REFERENCE_IOR
from .shading import body_transmission


def received(normal: torch.Tensor, leaves: Leaves, radiance: torch.Tensor) -> torch.Tensor:
    """Sum the irradiance that passes into a surface of the reference IoR, as the prefilter has it.

    Args:
        normal: unit. [P, 3]
        leaves: L directions with their point and solid angle; `node` is an index into `radiance`.
        radiance: RGB. [N, 3]

    Returns:
        RGB. [P, 3]
    """
    cosine = (normal[leaves.point] * leaves.direction).sum(1).clamp_min(0)
    eta = torch.tensor(REFERENCE_IOR, dtype=normal.dtype)
    weight = cosine * fresnel.transmittance(cosine, eta) * leaves.solid_angle
    return torch.zeros_like(normal).index_add(0, leaves.point, weight[:, None] * radiance[leaves.node])


def shade_samples(
    normal: torch.Tensor,
    view: torch.Tensor,
    albedo: torch.Tensor,
    roughness: torch.Tensor,
    ior: torch.Tensor,
    frame_x: torch.Tensor,
    frame_y: torch.Tensor,
    leaves: Leaves,
    radiance: torch.Tensor,
    lobe: str,
) -> torch.Tensor:
    """Shade points under light from single directions: as `shade` with exact Fresnel, the lobe summed over the leaves.

    A leaf's variance widens the lobe, so that a lamp cut into cells is mirrored as one.

    Args:
        normal: unit. [P, 3]
        view: unit, towards the camera. [P, 3]
        albedo: linear RGB. [P, 3]
        roughness: perceptual. [P]
        ior: index of refraction. [P]
        frame_x, frame_y: the pixels' Stokes axes, world. [P, 3]
        leaves: the light that arrives; `node` is an index into `radiance`.
        radiance: RGB. [N, 3]
        lobe: "ggx" or "beckmann".

    Returns:
        s0, s1, s2 by R, G, B. [P, 3, 3]
    """
    roughness = roughness.clamp(limits.MIN_ROUGHNESS, limits.MAX_ROUGHNESS)
    eta, alpha = ior.clamp_min(limits.MIN_IOR), roughness * roughness
    facing = (normal * view).sum(-1).clamp(limits.MIN_COSINE, 1.0)
    diffuse = body_transmission(facing, eta, "exact")[:, None] * albedo * received(normal, leaves, radiance)
    around = torch.stack(surface_pattern(normal, frame_x, frame_y), 1)[..., None]
    body = fresnel.diffuse_polarisation(facing, eta)[:, None, None] * around * diffuse[:, None]

    weight, h, vh = lobe_weights(normal, view, alpha, eta, leaves, lobe)
    scale = microfacet.masking(facing, alpha, lobe) / (4 * torch.pi * facing)
    mirrored = (weight * scale[leaves.point])[:, None] * radiance[leaves.node]
    x, y = frame_x[leaves.point], frame_y[leaves.point]
    cos2, sin2 = surface_pattern(h, x, y)
    square = (h * x).sum(1) ** 2 + (h * y).sum(1) ** 2
    across = fresnel.specular_polarisation(vh, square, eta[leaves.point])
    each = torch.stack((mirrored, -(across * cos2)[:, None] * mirrored, -(across * sin2)[:, None] * mirrored), 1)
    stokes = torch.zeros(len(normal), 3, 3, dtype=normal.dtype).index_add(0, leaves.point, each)
    return stokes + torch.cat((diffuse[:, None], body), 1)
