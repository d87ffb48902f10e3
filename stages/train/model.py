"""The Gaussians' parameters: raw tensors, activations, and start values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from .initialise.sampling import SurfaceSamples

ROUGHNESS_FLOOR = 0.08  # r_min of physics.md 3: sharper lobes than this alias in the prefiltered cube
IOR_LOW = 1.3  # eta = 1.3 + sigmoid (PhyGaP 9.1, with its slip mended)
PER_SPLAT = ("position", "normal", "tangent", "log_scale", "opacity", "albedo", "roughness_offset", "ior_offset")
SHARED = ("roughness", "ior")


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
    what every pixel agrees on is found at once. Normals and tangents are free vectors (normalised on use), so that
    neighbours can be compared and averaged without agreeing on a frame.
    """

    def __init__(self, tensors: dict[str, torch.Tensor]) -> None:
        self.tensors = {name: t.detach().clone().requires_grad_(True) for name, t in tensors.items()}

    @classmethod
    def from_samples(cls, samples: SurfaceSamples, albedo: float, roughness: float, ior: float, device: str) -> SplatModel:
        """Discs on the sampled surface: scale 0.75 of the spacing (the coverage at a gap's middle is then above 0.98)."""
        normal = torch.as_tensor(samples.normals, dtype=torch.float32)
        helper = torch.eye(3)[normal.abs().argmin(-1)]
        count = len(normal)
        tensors = {
            "position": torch.as_tensor(samples.points, dtype=torch.float32),
            "normal": normal,
            "tangent": torch.linalg.cross(helper, normal),
            "log_scale": torch.log(torch.as_tensor(0.75 * samples.spacing, dtype=torch.float32))[:, None].repeat(1, 2),
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

    def activated(self) -> Splats:
        """Every Gaussian's physical values, differentiable."""
        t = self.tensors
        normals = unit(t["normal"])
        quaternions = frame_quaternions(normals, t["tangent"])
        return Splats(
            means=t["position"],
            normals=normals,
            quaternions=quaternions,
            scales=torch.exp(t["log_scale"]),
            opacities=torch.sigmoid(t["opacity"]),
            albedo=torch.sigmoid(t["albedo"]),
            roughness=ROUGHNESS_FLOOR + (1 - ROUGHNESS_FLOOR) * torch.sigmoid(t["roughness"] + t["roughness_offset"]),
            ior=IOR_LOW + torch.sigmoid(t["ior"] + t["ior_offset"]),
        )

    def select(self, rows: torch.Tensor) -> None:
        """Keep these rows of every per-splat tensor, in place."""
        for name in PER_SPLAT:
            self.tensors[name] = self.tensors[name].detach()[rows].clone().requires_grad_(True)


def unit(v: torch.Tensor) -> torch.Tensor:
    """v / |v| along the last axis; a zero vector stays zero (1e-12 is far below any normalised length here)."""
    return torch.nn.functional.normalize(v, dim=-1, eps=1e-12)


def frame_quaternions(normals: torch.Tensor, tangents: torch.Tensor) -> torch.Tensor:
    """Quaternions wxyz [N, 4] of the rotations whose columns are t_u, t_v, n, from unit normals and rough tangents.

    Composed of two half-way rotations that stay smooth: z to n, then about n. The first is singular only at n = -z, where
    the antipodal one is used instead.
    """
    nx, ny, nz = normals.unbind(-1)
    flip = nz < 0
    sign = torch.where(flip, -1.0, 1.0)
    # rotation taking sign * z to n: q = (1 + sign nz, sign z x n)
    w = 1 + sign * nz
    q1 = torch.stack([w, -sign * ny, sign * nx, torch.zeros_like(w)], -1)
    # for sign = -1 start from the half turn about x, which takes z to -z and keeps x
    half_turn = normals.new_tensor([0.0, 1.0, 0.0, 0.0]).expand_as(q1)
    identity = normals.new_tensor([1.0, 0.0, 0.0, 0.0]).expand_as(q1)
    base = quaternion_product(torch.nn.functional.normalize(q1, dim=-1), torch.where(flip[:, None], half_turn, identity))
    axis_u = rotate(base, normals.new_tensor([1.0, 0.0, 0.0]))
    axis_v = rotate(base, normals.new_tensor([0.0, 1.0, 0.0]))
    tu, tv = (tangents * axis_u).sum(-1), (tangents * axis_v).sum(-1)
    angle = torch.atan2(tv, tu)
    spin = torch.stack([torch.cos(angle / 2), angle * 0, angle * 0, torch.sin(angle / 2)], -1)
    return quaternion_product(base, spin)


def quaternion_product(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Hamilton product of wxyz quaternions [..., 4]."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """v [3] turned by unit quaternions q [N, 4]: [N, 3]."""
    w, xyz = q[:, :1], q[:, 1:]
    v = v.expand_as(xyz)
    t = 2 * torch.linalg.cross(xyz, v)
    return v + w * t + torch.linalg.cross(xyz, t)


def to_numpy(splats: Splats) -> dict[str, np.ndarray]:
    """Every activated value as float32 arrays by field name."""
    return {name: getattr(splats, name).detach().cpu().numpy() for name in Splats.__dataclass_fields__}
