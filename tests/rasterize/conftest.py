"""Scenes for the rasteriser: ordinary ones and the ones that break rasterisers."""

from __future__ import annotations

import sys
import types
from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

IMAGES = ("features", "alpha", "normal", "depth_expected", "depth_median", "distortion")
INPUTS = ("means", "quats", "scales", "opacities", "features")


@dataclass(frozen=True)
class Scene:
    """Float32-representable inputs of `rasterize`, so that both precisions see the same numbers."""

    splats: tuple[Tensor, ...]  # means, quats, scales, opacities, features
    camera: Tensor  # [4, 4]
    intrinsics: Tensor  # [3, 3]
    width: int = 60
    height: int = 40

    def inputs(self, dtype: torch.dtype) -> list[Tensor]:
        return [tensor.to(dtype, copy=True).requires_grad_() for tensor in self.splats]

    def view(self, dtype: torch.dtype) -> tuple[Tensor, Tensor, int, int]:
        return self.camera.to(dtype), self.intrinsics.to(dtype), self.width, self.height

    def exact(self) -> Scene:
        """With a camera orthonormal to float64's digits."""
        camera = self.camera.double()
        u, _, v = torch.linalg.svd(camera[:3, :3])
        camera[:3, :3] = u @ v
        return replace(self, camera=camera)

    def scaled(self, factor: float) -> Scene:
        means, quats, scales, opacities, features = self.splats
        camera = self.camera.clone()
        camera[:3, 3] *= factor
        return replace(self, splats=(means * factor, quats, scales * factor, opacities, features), camera=camera)


def camera(distance: float = 4.0) -> Tensor:
    """A rolled, tilted view of the origin. [4, 4]"""
    angles = torch.tensor([0.4, -0.3, 0.2])
    result = torch.eye(4)
    skew = torch.zeros(3, 3)
    skew[0, 1], skew[0, 2], skew[1, 2] = -angles[2], angles[1], -angles[0]
    result[:3, :3] = torch.matrix_exp((skew - skew.T).double()).float()
    result[2, 3] = distance
    return result


def lens(fx: float = 60.0, fy: float = 63.0, cx: float = 28.0, cy: float = 22.0) -> Tensor:
    return torch.tensor([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def cloud(count: int, seed: int, *, spread: float = 0.5, low: float = 0.02, high: float = 0.22, channels: int = 5) -> Scene:
    """Splats of any orientation, size and opacity in front of the camera."""
    g = torch.Generator().manual_seed(seed)
    splats = (
        spread * torch.randn(count, 3, generator=g),
        torch.randn(count, 4, generator=g),
        low + (high - low) * torch.rand(count, 2, generator=g),
        torch.rand(count, generator=g),
        torch.randn(count, channels, generator=g),
    )
    return Scene(splats, camera(), lens())


def turned_to_camera(scene: Scene, degrees: Tensor) -> Scene:
    """The scene with every normal at an angle to its own viewing ray. degrees [N]"""
    means, _, scales, opacities, features = scene.splats
    rotation, shift = scene.camera[:3, :3].double(), scene.camera[:3, 3].double()
    ray = torch.nn.functional.normalize(means.double() + rotation.T @ shift, dim=1)
    g = torch.Generator().manual_seed(7)
    side = torch.nn.functional.normalize(torch.linalg.cross(ray, torch.randn(ray.shape, generator=g).double()), dim=1)
    angle = torch.deg2rad(degrees.double())[:, None]
    normal = ray * angle.cos() + side * angle.sin()
    half = torch.stack((1 + normal[:, 2], -normal[:, 1], normal[:, 0], torch.zeros(len(ray)).double()), 1)
    return replace(scene, splats=(means, half.float(), scales, opacities, features))


def scenes() -> dict[str, Scene]:
    plain = cloud(300, 0)
    means, quats, scales, opacities, features = plain.splats
    angles = torch.cat((torch.linspace(80, 100, 150), 90 + torch.logspace(-2, 0, 150)))
    needles = torch.stack((torch.full((300,), 0.6), torch.full((300,), 0.6e-4)), 1)
    behind = torch.cat((means[:150], means[150:] - (plain.camera[:3, :3].T @ torch.tensor([0.0, 0.0, 4.0]))))
    return {
        "plain": plain,
        "crowd": cloud(3000, 1, high=0.08),
        "edge-on": turned_to_camera(plain, angles),
        "exactly edge-on": turned_to_camera(plain, torch.full((300,), 90.0)),
        "needles": replace(plain, splats=(means, quats, needles, opacities, features)),
        "huge": replace(cloud(40, 2, spread=1.5, low=3.0, high=30.0)),
        "tiny": cloud(300, 3, low=1e-5, high=1e-3),
        "behind": replace(plain, splats=(behind, quats, scales, opacities, features)),
        "covering": turned_to_camera(cloud(40, 4, low=2.0, high=3.0), torch.linspace(0, 40, 40)),
        "opaque": replace(plain, splats=(means, quats, scales, torch.ones(300), features)),
        "faint": replace(plain, splats=(means, quats, scales, opacities * 0.02, features)),
        "off-centre": replace(plain, intrinsics=lens(fx=150, fy=90, cx=-40, cy=75), width=37, height=83),
        "one pixel": replace(plain, intrinsics=lens(cx=0.5, cy=0.5), width=1, height=1),
        "no channels": replace(plain, splats=(means, quats, scales, opacities, features[:, :0])),
        "many channels": replace(plain, splats=(means, quats, scales, opacities, features.repeat(1, 8)[:, :37])),
        "scale 1e-3": plain.scaled(1e-3),
        "scale 1e4": plain.scaled(1e4),
    }


SCENES = scenes()
QUICK = ("plain", "edge-on", "needles", "behind", "no channels")


@pytest.fixture(params=[pytest.param(n, marks=[] if n in QUICK else [pytest.mark.slow]) for n in SCENES])
def scene(request: pytest.FixtureRequest) -> Scene:
    return SCENES[request.param]


@pytest.fixture
def scene_named() -> Callable[[str], Scene]:
    return SCENES.__getitem__


@pytest.fixture
def gsplat_torch(monkeypatch: pytest.MonkeyPatch):
    """gsplat's plain torch 2DGS functions; nerfacc, which they import for two helpers, exists for CUDA only."""
    pytest.importorskip("gsplat")

    def render_weight_from_alpha(alphas: Tensor, ray_indices: Tensor, n_rays: int) -> tuple[Tensor, Tensor]:
        weights = torch.zeros_like(alphas)
        for ray in range(n_rays):
            mine = ray_indices == ray
            before = torch.cumprod(1 - alphas[mine], 0) / (1 - alphas[mine])
            weights = weights.masked_scatter(mine, alphas[mine] * before)
        return weights, weights

    def accumulate_along_rays(weights: Tensor, values: Tensor | None, ray_indices: Tensor, n_rays: int) -> Tensor:
        values = weights[:, None] if values is None else weights[:, None] * values
        return torch.zeros(n_rays, values.shape[1], dtype=values.dtype).index_add(0, ray_indices, values)

    stub = types.ModuleType("nerfacc")
    stub.render_weight_from_alpha = render_weight_from_alpha  # type: ignore[attr-defined]
    stub.accumulate_along_rays = accumulate_along_rays  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "nerfacc", stub)
    from gsplat.cuda import _torch_impl_2dgs

    return _torch_impl_2dgs
