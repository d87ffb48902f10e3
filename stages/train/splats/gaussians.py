"""The Gaussians' parameters: raw tensors, activations, and start values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..initialise.sampling import SurfaceSamples

ROUGHNESS_FLOOR = 0.08  # r_min, docs/physics.md: sharper lobes than this alias in the prefiltered cube
IOR_LOW = 1.3  # eta = 1.3 + sigmoid (PhyGaP 9.1, with its slip mended)
PER_SPLAT = ("anchor", "position", "normal", "log_scale", "opacity", "albedo", "roughness_offset", "ior_offset")
ACTIVATED = ("normal", "log_scale", "opacity", "albedo", "roughness_offset", "ior_offset", "roughness", "ior")
OPTIONAL = ("indirect",)  # per splat too, where there are any: `indirect.harmonics`


@dataclass(frozen=True)
class Splats:
    """Activated Gaussians: means [N, 3], unit outward normals [N, 3], quaternions wxyz [N, 4] (columns t_u, t_v, n),
    scales [N, 2], opacities [N], albedo [N, 3] in 0..1, roughness [N], ior [N]."""

    means: torch.Tensor
    normals: torch.Tensor
    quaternions: torch.Tensor
    scales: torch.Tensor
    opacities: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    ior: torch.Tensor


def logit(x: torch.Tensor | float) -> torch.Tensor:
    """Inverse of the sigmoid, for 0 < x < 1."""
    x = torch.as_tensor(x, dtype=torch.float32)
    return torch.log(x) - torch.log1p(-x)


class SplatModel:
    """Raw parameters by name; per-splat ones have N rows, shared ones none.

    Roughness and IoR are one shared value plus small offsets per splat: nearly every real object has one of each, and
    what every pixel agrees on is found at once. Normals are free vectors (normalised on use), so that neighbours can be
    compared and averaged without agreeing on a frame; discs are round, so a normal is all of an orientation.
    """

    def __init__(self, tensors: dict[str, torch.Tensor]) -> None:
        self.tensors = {name: t.detach().clone().requires_grad_(True) for name, t in tensors.items()}

    @classmethod
    def from_samples(cls, samples: SurfaceSamples, albedo: float, roughness: float, ior: float, device: str) -> SplatModel:
        """Discs on the sampled surface, half a spacing in sigma, all of one material.

        samples: positions, normals and spacing; albedo, roughness, ior: start values; device: of the tensors.
        """
        normal = torch.as_tensor(samples.normals, dtype=torch.float32)
        count = len(normal)
        tensors = {
            "anchor": torch.as_tensor(samples.points, dtype=torch.float32),  # where it started; never optimised
            "position": torch.as_tensor(samples.points, dtype=torch.float32),
            "normal": normal,
            "log_scale": torch.log(torch.as_tensor(0.5 * samples.spacing, dtype=torch.float32)),
            "opacity": logit(0.95).expand(count),
            "albedo": logit(albedo).expand(count, 3),
            "roughness_offset": torch.zeros(count),
            "ior_offset": torch.zeros(count),
            "roughness": logit((roughness - ROUGHNESS_FLOOR) / (1 - ROUGHNESS_FLOOR)),
            "ior": logit(ior - IOR_LOW),
        }
        return cls({name: t.to(device) for name, t in tensors.items()})

    def __len__(self) -> int:
        return len(self.tensors["position"])

    def __getitem__(self, name: str) -> torch.Tensor:
        return self.tensors[name]

    @property
    def per_splat(self) -> tuple[str, ...]:
        """Names of the tensors with a row for every splat."""
        return (*PER_SPLAT, *(name for name in OPTIONAL if name in self.tensors))

    def activated(self) -> Splats:
        """Every Gaussian's physical values, differentiable."""
        t = self.tensors
        if all(t[name].device.type == "cpu" and t[name].dtype == torch.float32 for name in ACTIVATED):
            from .activation import Activation

            return Splats(t["position"], *Activation.apply(*(t[name] for name in ACTIVATED)))
        return self.activated_plainly()

    def activated_plainly(self) -> Splats:
        """`activated` in torch: the definition."""
        t = self.tensors
        normals = unit(t["normal"])
        return Splats(
            means=t["position"],
            normals=normals,
            quaternions=normal_quaternions(normals.detach()),
            scales=torch.exp(t["log_scale"])[:, None].expand(-1, 2),
            opacities=torch.sigmoid(t["opacity"]),
            albedo=torch.sigmoid(t["albedo"]),
            roughness=ROUGHNESS_FLOOR + (1 - ROUGHNESS_FLOOR) * torch.sigmoid(t["roughness"] + t["roughness_offset"]),
            ior=IOR_LOW + torch.sigmoid(t["ior"] + t["ior_offset"]),
        )

    def select(self, rows: torch.Tensor) -> None:
        """Keep these rows of every per-splat tensor, in place."""
        for name in self.per_splat:
            self.tensors[name] = self.tensors[name].detach()[rows].clone().requires_grad_(True)


def unit(v: torch.Tensor) -> torch.Tensor:
    """v / |v| along the last axis; a zero vector stays zero (1e-12 is far below any normalised length here)."""
    return torch.nn.functional.normalize(v, dim=-1, eps=1e-12)


def normal_quaternions(normals: torch.Tensor) -> torch.Tensor:
    """Quaternions wxyz [N, 4] (not normalised) of rotations that take z to the unit normals [N, 3].

    The half-way rotation (1 + nz, -ny, nx, 0), singular only at n = -z: the lower half sphere takes the one composed with
    a half turn about x instead.
    """
    nx, ny, nz = normals.unbind(-1)
    zero = torch.zeros_like(nz)
    upper = torch.stack([1 + nz, -ny, nx, zero], -1)
    lower = torch.stack([-ny, 1 - nz, zero, nx], -1)
    return torch.where((nz >= 0)[:, None], upper, lower)


def to_numpy(splats: Splats) -> dict[str, np.ndarray]:
    """Every activated value as float32 arrays by field name."""
    return {name: getattr(splats, name).detach().cpu().numpy() for name in Splats.__dataclass_fields__}
