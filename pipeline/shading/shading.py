"""Deferred shading of a polarising dielectric: albedo, roughness, IoR and normal to Stokes vectors."""

from __future__ import annotations

from typing import Any

import torch

from pipeline.optics import fresnel as optics
from pipeline.optics.model_names import FRESNELS, MIRRORS, TREES
from pipeline.optics.stokes import surface_pattern

from . import limits, prefilter_kernels, splitsum
from .prefilter import LightField
from .types import Occlusion, Shaded, clamp_keeping_gradient


def shade(
    normal: torch.Tensor,  # [P, 3] unit, world
    view: torch.Tensor,  # [P, 3] unit, world, towards the camera
    albedo: torch.Tensor,  # [P, 3] diffuse reflectance, linear RGB
    roughness: torch.Tensor,  # [P] perceptual, alpha = r^2
    ior: torch.Tensor,  # [P] eta >= 1
    frame_x: torch.Tensor,  # [P, 3] the pixel's Stokes axes: unit, world, perpendicular to view; no gradient
    frame_y: torch.Tensor,  # [P, 3]
    light: LightField,
    *,
    occlusion: Occlusion | None = None,
    fresnel: str = "exact",
    mirror: str = "split",
) -> Shaded:
    """Stokes vectors of P points under a prefiltered environment; differentiable in all but the frame.

    Values outside `limits` are clamped, their gradient kept. float32 on the CPU runs a fused kernel ("exact" only).

    Args:
        normal: unit, world. [P, 3]
        view: unit, world, towards the camera. [P, 3]
        albedo: diffuse reflectance, linear RGB, 0..1. [P, 3]
        roughness: perceptual, alpha = roughness^2. [P]
        ior: index of refraction, from 1. [P]
        frame_x, frame_y: the pixel's Stokes axes, unit, world (`Camera.stokes_frame`). [P, 3]
        light: the environment (`Prefilter.apply`).
        occlusion: what the object takes from and adds to that light; None: nothing.
        fresnel: "exact" transmits light into and out of the body (Baek et al. 2018, polarised plastic) and integrates
            Fresnel's equations over the lobe; "schlick" is PhyGaP Eq. 20, (1 - F_schlick) albedo/pi E, with F0 tau0 + tau1.
        mirror: "split" sum; "tree", "tree-coarse", "tree-fine", a quadrature over the environment's texels (`light_tree`); or
            "lobe-4" to "lobe-48" facets (`lobe`). All but the split sum with exact Fresnel only.

    Returns:
        Radiance towards the camera in the light's units, as Stokes vectors and as diffuse and specular parts.

    Raises:
        ValueError: an unknown name, or facets with Schlick.
    """
    if fresnel not in FRESNELS:
        raise ValueError(f"fresnel {fresnel!r}: must be one of {', '.join(FRESNELS)}")
    if mirror not in MIRRORS or (mirror != "split" and fresnel != "exact"):
        raise ValueError(f"mirror {mirror!r}: must be one of {', '.join(MIRRORS)}, and split with Schlick")
    arguments = (normal, view, albedo, roughness, ior, frame_x, frame_y)
    fast = fresnel == "exact" and all(x.device.type == "cpu" and x.dtype == torch.float32 for x in (*arguments, light.packed))
    if not fast:
        return plain(*arguments, light, occlusion=occlusion, fresnel=fresnel, mirror=mirror)
    return _fused(arguments, light, occlusion, mirror)


def _fused(arguments: tuple[torch.Tensor, ...], light: LightField, occlusion: Occlusion | None, mirror: str) -> Shaded:
    """`shade` of (normal, view, albedo, roughness, ior, frame_x, frame_y) by the fused kernel."""
    blocked = (None,) * 4 if occlusion is None else (
        occlusion.shadow, occlusion.bounced, occlusion.unblocked, occlusion.seen
    )  # fmt: skip
    given: tuple[torch.Tensor | None, ...] = (None, None)
    normal, view, _, roughness, ior, frame_x, frame_y = arguments
    if mirror in TREES:
        from . import light_tree

        given = light_tree.mirrored(
            normal, view, roughness, ior, frame_x, frame_y, light.tree, light.lobe, TREES[mirror]
        )  # fmt: skip
    elif mirror != "split":
        from .lobe import mirrored

        given = mirrored(normal, view, roughness, ior, frame_x, frame_y, light, mirror)
    return Shaded(*_FusedShading.apply(light, *arguments, light.packed, *blocked, *given))


def plain(
    normal: torch.Tensor,
    view: torch.Tensor,
    albedo: torch.Tensor,
    roughness: torch.Tensor,
    ior: torch.Tensor,
    frame_x: torch.Tensor,
    frame_y: torch.Tensor,
    light: LightField,
    *,
    occlusion: Occlusion | None = None,
    fresnel: str = "exact",
    mirror: str = "split",
) -> Shaded:
    """`shade` in readable torch, any float type and device: the definition."""
    roughness = clamp_keeping_gradient(roughness, limits.MIN_ROUGHNESS, limits.MAX_ROUGHNESS)
    eta = clamp_keeping_gradient(ior, limits.MIN_IOR, float("inf"))
    facing = (normal * view).sum(-1)
    cosine = clamp_keeping_gradient(facing, limits.MIN_COSINE, 1.0)

    cos2, sin2 = surface_pattern(normal, frame_x, frame_y)
    around = torch.stack((cos2, sin2), 1)[..., None]
    received = light.irradiance(normal, transmitted=fresnel == "exact")
    reflected, across = mirror_reflection(normal, cosine, roughness, eta, frame_x, frame_y, light.lobe, fresnel)
    if mirror == "split":
        mirrored = light.mirrored(2 * facing[:, None] * normal - view, roughness)
        turned = across[:, None, None] * around * mirrored[:, None]
    elif mirror in TREES:
        from . import light_tree_plain

        mirrored, turned = light_tree_plain.plain(
            normal, view, roughness, eta, frame_x, frame_y, light.tree, light.lobe, TREES[mirror]
        )  # fmt: skip
    else:
        from .lobe import plain as lobe

        mirrored, turned = lobe(normal, view, roughness, eta, frame_x, frame_y, light, mirror)
    if occlusion is not None:
        received = occlusion.shadow * received + occlusion.bounced
        mirrored = occlusion.unblocked[:, None] * mirrored + occlusion.seen
        own = across[:, None, None] * around * occlusion.seen[:, None]
        turned = occlusion.unblocked[:, None, None] * turned + own
    diffuse = body_transmission(cosine, eta, fresnel)[:, None] * albedo * received
    specular = reflected[:, None] * mirrored
    body = optics.diffuse_polarisation(cosine, eta)[:, None, None] * around * diffuse[:, None]
    stokes = torch.cat(((diffuse + specular)[:, None], body - reflected[:, None, None] * turned), dim=1)
    return Shaded(stokes, diffuse, specular)


def body_transmission(cosine: torch.Tensor, eta: torch.Tensor, fresnel: str) -> torch.Tensor:
    """Compute the light that leaves the body, over albedo x received light (docs/physics.md, Shading).

    Out of the body, and in relative to the level's IoR. Source: Baek et al. 2018 (polarised plastic); "schlick": PhyGaP Eq. 20.

    Args:
        cosine: of view and normal, in (0, 1]. [P]
        eta: index of refraction. [P]
        fresnel: "exact" or "schlick".

    Returns:
        1/sr. [P]
    """
    if fresnel == "schlick":
        return (1 - optics.schlick(cosine, eta)) / torch.pi
    reference = torch.tensor(prefilter_kernels.REFERENCE_IOR, dtype=eta.dtype)  # on the CPU: a number, which mixes with any
    entering = optics.hemispherical_transmittance(eta) / optics.hemispherical_transmittance(reference)
    return optics.transmittance(cosine, eta) * entering / torch.pi


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
    """Albedo of the rough mirror, and its polarisation over sin^2, by the tables of `splitsum`.

    Args:
        normal, frame_x, frame_y: as in `shade`. [P, 3]
        cosine: of the view with the normal, in (0, 1]. [P]
        roughness, eta: inside `limits`. [P]
        lobe: "ggx" or "beckmann".
        fresnel: "exact" or "schlick".

    Returns:
        (albedo [P] in 0..1, beta / sin^2 [P] >= 0).
    """
    where = (roughness * (splitsum.ROUGHNESS_NODES - 1), cosine.sqrt() * (splitsum.COSINE_NODES - 1))
    values = splitsum.table_on(fresnel, lobe, cosine.device).to(cosine.dtype)
    if fresnel == "schlick":
        tau0, tau1 = splitsum.lookup(values, where).unbind(-1)
        squared_sine = (normal * frame_x).sum(-1) ** 2 + (normal * frame_y).sum(-1) ** 2
        across = optics.specular_polarisation(cosine, squared_sine, eta)
        return optics.normal_reflectance(eta) * tau0 + tau1, across
    low, high = splitsum.IOR_RANGE
    index = (eta - low) * ((splitsum.IOR_NODES - 1) / (high - low))
    rho, across = splitsum.lookup(values, (index, *where)).unbind(-1)
    return optics.reflectance(cosine, eta) * rho, across


class _FusedShading(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, light: LightField, *tensors: torch.Tensor | None) -> tuple[torch.Tensor, ...]:
        from . import shade_kernels

        inputs = [torch.empty(0) if x is None else x.detach().contiguous() for x in tensors]
        # Absent occlusion and lobe: empty arrays of the right rank.
        if tensors[8] is None:
            inputs[8:12] = [torch.empty(0, 3), torch.empty(0, 3), torch.empty(0), torch.empty(0, 3)]
        if tensors[12] is None:
            inputs[12:] = [torch.empty(0, 3), torch.empty(0, 2, 3)]
        ctx.arrays, ctx.light, ctx.given = [x.numpy() for x in inputs], light, [x is not None for x in tensors]
        points = len(ctx.arrays[0])
        out = (torch.empty(points, 3, 3), torch.empty(points, 3), torch.empty(points, 3))
        kernel: Any = shade_kernels.forward
        kernel(*ctx.arrays[:8], *light.tables(), *ctx.arrays[8:], *(x.numpy() for x in out))
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        from . import shade_kernels

        a = ctx.arrays
        tables = torch.zeros(shade_kernels.chunks(len(a[0])), *a[7].shape)
        new = [torch.empty(x.shape) for x in (*a[:5], *a[8:])]
        kernel: Any = shade_kernels.backward
        kernel(
            *a[:8], *ctx.light.tables(), *a[8:], *(g.contiguous().numpy() for g in gradients),
            *(x.numpy() for x in new[:5]), tables.numpy(), *(x.numpy() for x in new[5:]),
        )  # fmt: skip
        optional = [x if given else None for x, given in zip(new[5:], ctx.given[8:])]
        return (None, *new[:5], None, None, tables.sum(0), *optional)
