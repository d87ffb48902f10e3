"""The reference itself: against geometry written another way, finite differences, and gsplat's torch functions."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from stages.train.rasterize import constants, rasterize
from stages.train.rasterize.reference import project, splat_alpha

INPUTS = ("means", "quats", "scales", "opacities", "features")


def one_splat(mean, quat, scale, opacity=0.8) -> list[Tensor]:
    rows = (mean, quat, scale)
    return [torch.tensor([row], dtype=torch.float64) for row in rows] + [
        torch.tensor([opacity], dtype=torch.float64),
        torch.ones(1, 1, dtype=torch.float64),
    ]


def test_one_splat_is_a_gaussian_on_the_plane_its_rays_meet(scene_named) -> None:
    scene = scene_named("plain").exact()
    mean, quat, scale, opacity = (0.1, -0.2, 0.3), (0.8, 0.3, -0.4, 0.2), (0.5, 0.25), 0.8
    camera, K, width, height = scene.view(torch.float64)
    splat = one_splat(mean, quat, scale, opacity)
    raster = rasterize(*splat, camera, K, width, height, backend="reference", screen_filter=False)

    w, x, y, z = torch.nn.functional.normalize(splat[1][0], dim=0)
    half = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    axes = torch.eye(3, dtype=torch.float64) + 2 * w * half + 2 * half @ half  # Rodrigues, columns t_u, t_v, n
    origin = -camera[:3, :3].T @ camera[:3, 3]
    worst = 0.0
    for row in range(height):
        for column in range(width):
            pixel = torch.tensor([column + 0.5, row + 0.5, 1.0], dtype=torch.float64)
            direction = camera[:3, :3].T @ torch.linalg.solve(K, pixel)  # camera z = 1
            system = torch.stack((axes[:, 0] * scale[0], axes[:, 1] * scale[1], -direction), 1)
            u, v, depth = torch.linalg.solve(system, origin - splat[0][0])
            rho = float(u * u + v * v)
            if abs(rho - constants.CUTOFF_RHO) < 1e-6:
                continue
            alpha = opacity * math.exp(-0.5 * rho) if rho < constants.CUTOFF_RHO else 0.0
            alpha = alpha if alpha >= constants.ALPHA_MIN else 0.0
            worst = max(worst, abs(float(raster.alpha[row, column]) - alpha))
            worst = max(worst, abs(float(raster.depth_expected[row, column]) - alpha * float(depth)))
            normal = axes[:, 2] * (-1 if float(axes[:, 2] @ direction) > 0 else 1)
            worst = max(worst, float((raster.normal[row, column] - alpha * normal).abs().max()))
    assert worst < 1e-12
    assert raster.alpha.max() > 0.7


def test_the_screen_filter_keeps_an_edge_on_splat_visible() -> None:
    K = torch.tensor([[50.0, 0, 8.5], [0, 50.0, 8.5], [0, 0, 1.0]])
    side = math.sqrt(0.5)
    splat = one_splat((0.0, 0.0, 2.0), (side, 0.0, side, 0.0), (1e-3, 1e-3))  # normal along x
    views = {f: rasterize(*splat, torch.eye(4), K, 17, 17, backend="reference", screen_filter=f) for f in (True, False)}
    assert views[False].alpha.max() == 0
    assert views[True].alpha[8, 8] == pytest.approx(0.8)
    assert views[True].alpha[8, 9] == pytest.approx(0.8 * math.exp(-0.5 * constants.SCREEN_INVERSE_VARIANCE))
    assert views[True].depth_expected[8, 9] == pytest.approx(2 * float(views[True].alpha[8, 9]))


def test_blending_stops_and_the_median_is_where_half_is_left() -> None:
    """Four big parallel splats of opacity 0.99 at z = 1..4: the third would leave 1e-6 < 1e-4."""
    count = 4
    means = torch.zeros(count, 3, dtype=torch.float64)
    means[:, 2] = torch.arange(1, count + 1)
    quats = torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64).expand(count, 4)
    K = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1.0]])
    arguments = (quats, torch.ones(count, 2).double() * 9, torch.ones(count).double(), torch.eye(count).double())
    raster = rasterize(means, *arguments, torch.eye(4), K, 1, 1, backend="reference", near=0.5)
    assert raster.features[0, 0].tolist() == pytest.approx([0.99, 0.0099, 0.0, 0.0])
    assert raster.depth_median[0, 0] == pytest.approx(1.0)
    assert raster.distortion[0, 0] == pytest.approx(0.99 * 0.0099 * (2 - 1) ** 2)


def test_splats_of_one_layer_show_their_mean_and_hide_what_is_behind() -> None:
    """Big parallel splats of opacity 0.5, 0.25 | 0.5 | 0.5 at z = 1, 1.05 | 2 | 3, whatever order the first two have."""
    means = torch.zeros(4, 3, dtype=torch.float64)
    quats = torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64).expand(4, 4)
    opacities = torch.tensor([0.5, 0.25, 0.5, 0.5], dtype=torch.float64)
    K = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1.0]])
    arguments = (quats, torch.ones(4, 2).double() * 9, opacities, torch.eye(4).double())
    covered = 1 - 0.5 * 0.75
    for depths in ((1.0, 1.05, 2.0, 3.0), (1.05, 1.0, 2.0, 3.0)):
        means[:, 2] = torch.tensor(depths)
        raster = rasterize(means, *arguments, torch.eye(4), K, 1, 1, backend="reference", near=0.5, layer=0.1)
        behind = (1 - covered) * 0.5
        assert raster.features[0, 0].tolist() == pytest.approx([covered * 2 / 3, covered / 3, behind, behind / 2])
        assert float(raster.alpha[0, 0]) == pytest.approx(covered + behind * 1.5)


def test_a_clump_of_hundreds_in_one_layer_is_the_same_in_float32() -> None:
    """The transmittance would leave float32's range: both end the pixel first."""
    count, g = 200, torch.Generator().manual_seed(3)
    means = torch.zeros(count, 3)
    means[:, 2] = 2 + 0.01 * torch.rand(count, generator=g)
    quats = torch.tensor([[1.0, 0, 0, 0]]).expand(count, 4)
    inputs = [means, quats, torch.full((count, 2), 9.0), torch.full((count,), 0.9), torch.rand(count, 2, generator=g)]
    camera = (torch.eye(4), torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1.0]]), 1, 1)
    exact = rasterize(*(t.double() for t in inputs), *camera, backend="reference", near=0.5, layer=0.5)
    fast = rasterize(*inputs, *camera, backend="cpu", near=0.5, layer=0.5)
    assert torch.allclose(fast.features.double(), exact.features, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("layer", [0.0, 0.3])
def test_gradients_are_finite_differences(scene_named, layer) -> None:
    scene = replace(scene_named("plain"), width=9, height=7)
    chosen = slice(0, 6)
    scene = replace(
        scene,
        splats=tuple(t[chosen] for t in scene.splats),
        intrinsics=torch.tensor([[12.0, 0, 4.2], [0, 12, 3.3], [0, 0, 1]]),
    )

    g = torch.Generator().manual_seed(2)
    weights = torch.randn(scene.height, scene.width, scene.splats[-1].shape[1] + 7, generator=g).double()

    def weighted_images(*inputs: Tensor) -> Tensor:
        r = rasterize(*inputs, *scene.view(torch.float64), backend="reference", near=0.1, layer=layer)
        scalars = torch.stack((r.alpha, r.depth_expected, r.depth_median, r.distortion), -1)
        return (torch.cat((r.features, r.normal, scalars), -1) * weights).sum()

    assert torch.autograd.gradcheck(weighted_images, scene.inputs(torch.float64), eps=1e-6, atol=1e-5)


@pytest.mark.parametrize(
    ("size", "tolerance"),
    [
        (1.0, 1e-9),  # pure object-space kernel: the same formula (measured 1e-13)
        (0.02, 3e-3),  # sub-pixel: gsplat centres the screen kernel on the outline's box, here on the projected mean (6e-4)
    ],
)
def test_gsplat_projects_and_blends_the_same(gsplat_torch, scene_named, size, tolerance) -> None:
    """Given the same (pixel, splat) pairs, gsplat's own projection and compositing give the same images and gradients."""
    scene = replace(
        scene_named("plain").exact(), width=13, height=11, intrinsics=torch.tensor([[15.0, 0, 6], [0, 15, 5], [0, 0, 1.0]])
    )
    means, quats, scales, opacities, features = (t[:24] for t in scene.splats)
    facing = torch.tensor([1.0, 0.05, 0.05, 0.05])  # within 20 degrees of the camera's axis: outlines wider than the filter
    scene = replace(scene, splats=(means, quats * 0.05 + facing, scales * size + 0.3 * size, 0.05 + 0.4 * opacities, features))
    camera, K, width, height = scene.view(torch.float64)
    ours, theirs = scene.inputs(torch.float64), scene.inputs(torch.float64)
    raster = rasterize(*ours, camera, K, width, height, backend="reference", near=0.01)

    means, quats, scales, opacities, features = theirs
    scales3 = torch.cat((scales, torch.ones_like(scales[:, :1])), 1)
    _, means2d, depths, transforms, normals = gsplat_torch._fully_fused_projection_2dgs(
        means, quats, scales3, camera[None], K[None], width, height
    )
    order = depths[0].argsort()
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = torch.stack((x, y), -1).reshape(-1, 2).double() + 0.5
    with torch.no_grad():
        splats = project(*ours[:4], camera, K, 0.01, True)
        alpha, _ = splat_alpha(pixels, splats, splats.centre[None], ours[3][splats.index], 0.01, True)
    assert (splats.index == order).all()
    pixel_ids, rank = (alpha > 0).nonzero(as_tuple=True)
    colors, alphas, normal = gsplat_torch.accumulate_2dgs(
        means2d, transforms, opacities[None], features[None], normals, order[rank], pixel_ids,
        torch.zeros_like(rank), width, height,
    )  # fmt: skip
    pairs = [
        (raster.features, colors[0]),
        (raster.alpha, alphas[0, ..., 0]),
        (raster.normal, normal[0] @ camera[:3, :3]),
    ]
    g = torch.Generator().manual_seed(3)
    cotangents = [torch.randn(a.shape, generator=g).double() for a, _ in pairs]
    for mine, other in pairs:
        assert float((mine - other).detach().norm() / other.detach().norm()) < tolerance
    torch.autograd.backward([a for a, _ in pairs], cotangents)
    torch.autograd.backward([b for _, b in pairs], cotangents)
    for name, mine, other in zip(INPUTS, ours, theirs):
        assert mine.grad is not None and other.grad is not None
        if size == 1 or name not in ("scales", "quats"):  # gsplat moves the box's centre with these, by 1e-4 px
            assert float((mine.grad - other.grad).norm() / other.grad.norm()) < 10 * tolerance
    assert raster.alpha.max() > 0.3
