"""Deferred shading of a polarising dielectric: albedo, roughness, IoR and normal to Stokes vectors."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from pipeline.optics import fresnel as optics
from pipeline.optics.microfacet import MIN_ROUGHNESS
from pipeline.optics.stokes import surface_pattern

from . import kernels, splitsum
from .prefilter import LightField

# Normals turned away are shaded at this cosine (89.4 degrees): beyond it nothing is visible of a real surface.
MIN_COSINE = 0.01
FRESNELS = ("exact", "schlick")


@dataclass(frozen=True)
class Shaded:
    """Radiance leaving P points towards the camera, linear RGB.

    stokes [P, 3 (s0, s1, s2), 3 (rgb)]; diffuse + specular = s0, both [P, 3].
    """

    stokes: torch.Tensor
    diffuse: torch.Tensor
    specular: torch.Tensor


def shade(
    normal: torch.Tensor,  # [P, 3] unit, world
    view: torch.Tensor,  # [P, 3] unit, world, towards the camera
    albedo: torch.Tensor,  # [P, 3] diffuse reflectance, linear RGB
    roughness: torch.Tensor,  # [P] perceptual, alpha = r^2
    ior: torch.Tensor,  # [P] eta >= 1
    frame_x: torch.Tensor,  # [P, 3] the pixel's Stokes axes: unit, world, perpendicular to view
    frame_y: torch.Tensor,  # [P, 3]
    light: LightField,
    *,
    fresnel: str = "exact",
) -> Shaded:
    """Stokes vectors of P points under a prefiltered environment; differentiable in every tensor.

    fresnel: "exact" transmits light into and out of the body (Baek et al.'s polarised plastic); "schlick" is
    PhyGaP Eq. 20, (1 - F_schlick) albedo/pi E.
    """
    if fresnel not in FRESNELS:
        raise ValueError(f"fresnel {fresnel!r}: must be one of {', '.join(FRESNELS)}")
    roughness = clamp_keeping_gradient(roughness, MIN_ROUGHNESS, 1.0)
    eta = clamp_keeping_gradient(ior, 1.0, float("inf"))
    facing = (normal * view).sum(-1)
    cosine = clamp_keeping_gradient(facing, MIN_COSINE, 1.0)
    mirror = 2 * facing[:, None] * normal - view

    diffuse = diffuse_radiance(normal, cosine, albedo, eta, light, fresnel)
    reflected, across = mirror_reflection(normal, cosine, roughness, eta, frame_x, frame_y, light.lobe, fresnel)
    specular = reflected[:, None] * light.mirrored(mirror, roughness)

    cos2, sin2 = surface_pattern(normal, frame_x, frame_y)
    polarised = optics.diffuse_polarisation(cosine, eta)[:, None] * diffuse - across[:, None] * specular
    stokes = torch.stack((diffuse + specular, cos2[:, None] * polarised, sin2[:, None] * polarised), dim=1)
    return Shaded(stokes, diffuse, specular)


def mirror_reflection(
    normal: torch.Tensor,
    cosine: torch.Tensor,
    roughness: torch.Tensor,
    eta: torch.Tensor,
    frame_x: torch.Tensor,
    frame_y: torch.Tensor,
    lobe: str,
    fresnel: str,
) -> tuple[torch.Tensor, torch.Tensor]:
    """(albedo of the rough mirror [P], its polarisation over sin^2 [P]): see `splitsum`."""
    where = (roughness * (splitsum.ROUGHNESS_NODES - 1), cosine.sqrt() * (splitsum.COSINE_NODES - 1))
    table = splitsum.exact_table if fresnel == "exact" else splitsum.schlick_table
    values = torch.as_tensor(table(lobe), dtype=cosine.dtype, device=cosine.device)
    if fresnel == "schlick":
        tau0, tau1 = splitsum.lookup(values, where).unbind(-1)
        squared_sine = (normal * frame_x).sum(-1) ** 2 + (normal * frame_y).sum(-1) ** 2
        across = optics.specular_polarisation(cosine, squared_sine, eta)
        return optics.normal_reflectance(eta) * tau0 + tau1, across
    low, high = splitsum.IOR_RANGE
    index = (eta - low) * ((splitsum.IOR_NODES - 1) / (high - low))
    rho, across = splitsum.lookup(values, (index, *where)).unbind(-1)
    return optics.reflectance(cosine, eta) * rho, across


def diffuse_radiance(
    normal: torch.Tensor,
    cosine: torch.Tensor,
    albedo: torch.Tensor,
    eta: torch.Tensor,
    light: LightField,
    fresnel: str,
) -> torch.Tensor:
    """L_d [P, 3]: light through the surface, off the pigment, and out."""
    if fresnel == "schlick":
        leaving = 1 - optics.schlick(cosine, eta)
    else:
        reference = torch.tensor(kernels.REFERENCE_IOR, dtype=eta.dtype, device=eta.device)
        entering = optics.hemispherical_transmittance(eta) / optics.hemispherical_transmittance(reference)
        leaving = optics.transmittance(cosine, eta) * entering
    received = light.irradiance(normal, transmitted=fresnel == "exact")
    return (leaving / torch.pi)[:, None] * albedo * received


def clamp_keeping_gradient(x: torch.Tensor, low: float, high: float) -> torch.Tensor:
    """x limited to [low, high]; the gradient passes as if it were not, so that a value outside finds back."""
    return x + (x.clamp(low, high) - x).detach()
