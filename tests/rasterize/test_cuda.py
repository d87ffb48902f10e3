"""The gsplat backend: what it says without CUDA, its wiring on the CPU, and its images and gradients on a GPU."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from pipeline.errors import UserError
from stages.train.rasterize import cuda, rasterize
from stages.train.rasterize.reference import project, splat_alpha

IMAGES = ("features", "alpha", "normal", "depth_expected", "depth_median")
INPUTS = ("means", "quats", "scales", "opacities", "features")
has_cuda = torch.cuda.is_available()


@pytest.mark.skipif(has_cuda, reason="there is a CUDA device")
def test_without_a_cuda_device_the_message_says_so_and_what_to_do(scene_named) -> None:
    scene = scene_named("plain")
    with pytest.raises(UserError, match=r"no CUDA device.*--device cpu"):
        rasterize(*scene.splats, *scene.view(torch.float32), backend="cuda")


@pytest.mark.parametrize("missing", ["nvcc", "ninja"])
def test_a_missing_toolkit_is_named(monkeypatch, missing) -> None:
    pytest.importorskip("gsplat")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(cuda, "find_spec", lambda name: None if name == "gsplat.csrc" else object())
    monkeypatch.setenv("CUDA_HOME", "/nowhere")
    monkeypatch.setattr(cuda.shutil, "which", lambda tool: None if tool == missing else f"/usr/bin/{tool}")
    with pytest.raises(UserError, match=f"{missing}.* is missing.*CUDA_HOME"):
        cuda.gsplat_functions()


def steep_free(scene, grow: float = 0.1):
    """Splats within 40 degrees of the camera's axis and a few pixels wide: gsplat's outline boxes are then centred alike."""
    means, quats, scales, opacities, features = scene.splats
    quats = 0.1 * quats + torch.tensor([1.0, 0.0, 0.0, 0.0])
    return replace(scene, splats=(means, quats, grow + scales, 0.1 + 0.5 * opacities, features))


def gsplat_in_torch(scene, torch_functions) -> SimpleNamespace:
    """gsplat's functions from its torch ones, on the pairs that the reference blends."""
    camera, K, width, height = scene.view(torch.float32)

    def pixels() -> Tensor:
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        return torch.stack((x, y), -1).reshape(-1, 2).float() + 0.5

    def pairs(*_):
        splats = project(*scene.splats[:4], camera, K, 0.01, True)
        alpha, _ = splat_alpha(pixels(), splats, splats.centre[None], scene.splats[3][splats.index], 0.01, True)
        pixel, rank = (alpha > 0).nonzero(as_tuple=True)
        return splats.index[rank], pixel

    def blend(means2d, transforms, colours, opacities, normals, densify, *_, masks=None):
        ids, pixel = pairs()
        arguments = (means2d, transforms, opacities, colours, normals, ids, pixel, torch.zeros_like(ids), width, height)
        blended, alphas, normal = torch_functions.accumulate_2dgs(*arguments)
        median = torch.full_like(alphas, 4.0)
        return blended + 0 * densify.sum(), alphas, normal, None, median

    def project_all(means, quats, scales, camera, K, width, height, near_plane):
        radii, *rest = torch_functions._fully_fused_projection_2dgs(means, quats, scales, camera, K, width, height, near_plane)
        return radii, *rest

    return SimpleNamespace(
        fully_fused_projection_2dgs=project_all,
        isect_tiles=lambda *_, **__: (None, None, None),
        isect_offset_encode=lambda _, images, columns, rows: torch.zeros(images, rows, columns),
        rasterize_to_pixels_2dgs=blend,
        rasterize_to_indices_in_range_2dgs=pairs,
    )


@pytest.mark.slow
@pytest.mark.parametrize("layer", [0.0, 0.3])
def test_the_wiring_gives_the_reference_images(gsplat_torch, scene_named, monkeypatch, layer) -> None:
    """With gsplat's own torch functions in place of its kernels, units, frames and channel order are the reference's."""
    plain = scene_named("plain")
    scene = steep_free(replace(plain, splats=tuple(t[:20] for t in plain.splats), width=20, height=13), grow=0.4)
    scene = replace(scene, intrinsics=torch.tensor([[20.0, 0, 9], [0, 20, 6], [0, 0, 1.0]]))
    monkeypatch.setattr(cuda, "gsplat_functions", lambda: gsplat_in_torch(scene, gsplat_torch))
    ours, theirs = scene.inputs(torch.float32), scene.inputs(torch.float32)
    mask = torch.zeros(13, 20, dtype=torch.bool)
    mask[2:9, 3:17] = True
    truth = rasterize(*ours, *scene.view(torch.float32), backend="reference", near=0.01, pixel_mask=mask, layer=layer)
    value = rasterize(*theirs, *scene.view(torch.float32), backend="cuda", near=0.01, pixel_mask=mask, layer=layer)
    for name in ("features", "alpha", "normal"):
        assert torch.allclose(getattr(value, name), getattr(truth, name), atol=2e-4), name
    # depth of centres against depth of intersections: within the splats' own extent in z
    apart = (value.depth_expected - truth.depth_expected).detach().abs()
    assert float(apart.max()) < 0.3 and float(apart.median()) < 0.02
    assert value.distortion.min() > -1e-5
    assert float((value.distortion - truth.distortion).detach().norm() / truth.distortion.detach().norm()) < 0.2
    for raster in (truth, value):
        (raster.features.sum() + raster.normal[..., 0].sum()).backward()
    for name, a, b in zip(INPUTS, ours, theirs):
        assert a.grad is not None and b.grad is not None
        assert float((a.grad - b.grad).norm() / a.grad.norm()) < 2e-3, name
    if layer:  # with gsplat's torch functions the shift gets no gradient without layers
        assert value.screen_gradient.max() > 0.1 * truth.screen_gradient.max()


@pytest.mark.skipif(not has_cuda, reason="needs a CUDA device")
@pytest.mark.parametrize("name", ["plain", "crowd", "off-centre", "scale 1e-3", "scale 1e4", "no channels", "many channels"])
@pytest.mark.parametrize("layer", [0.0, 0.1])
def test_gpu_equals_reference(scene_named, name, layer) -> None:
    """Within gsplat's looser cut-off and centre depths: 2 % of the images, 5 % of the gradients, in 2-norm."""
    layer *= {"scale 1e-3": 1e-3, "scale 1e4": 1e4}.get(name, 1.0)
    scene = steep_free(scene_named(name)) if not name.startswith("scale") else scene_named(name)
    ours = scene.inputs(torch.float64)
    theirs = [t.detach().float().cuda().requires_grad_() for t in ours]
    camera, K, width, height = scene.view(torch.float32)
    truth = rasterize(*ours, *scene.view(torch.float64), backend="reference", layer=layer)
    value = rasterize(*theirs, camera.cuda(), K.cuda(), width, height, backend="cuda", layer=layer)
    g = torch.Generator().manual_seed(0)
    losses = []
    for key in IMAGES[:-1]:
        a, b = getattr(truth, key), getattr(value, key)
        if a.numel():
            assert float((a - b.cpu()).detach().norm() / a.detach().norm()) < 0.02, key
            cotangent = torch.randn(a.shape, generator=g)
            losses.append(((a * cotangent).sum() / a.detach().norm(), (b * cotangent.cuda()).sum() / a.detach().norm()))
    sum(a for a, _ in losses).backward()  # type: ignore[union-attr]
    sum(b for _, b in losses).backward()  # type: ignore[union-attr]
    for key, a, b in zip(INPUTS, ours, theirs):
        if a.numel():
            assert a.grad is not None and b.grad is not None and b.grad.isfinite().all()
            assert float((a.grad - b.grad.cpu()).norm() / a.grad.norm()) < 0.05, key


@pytest.mark.skipif(not has_cuda, reason="needs a CUDA device")
@pytest.mark.parametrize("name", ["edge-on", "needles", "huge", "tiny", "behind", "covering", "opaque"])
@pytest.mark.parametrize("layer", [0.0, 0.1])
def test_gpu_is_finite_on_hostile_scenes(scene_named, name, layer) -> None:
    scene = scene_named(name)
    inputs = [t.detach().cuda().requires_grad_() for t in scene.splats]
    camera, K, width, height = scene.view(torch.float32)
    raster = rasterize(*inputs, camera.cuda(), K.cuda(), width, height, backend="cuda", layer=layer)
    sum(getattr(raster, key).sum() for key in IMAGES).backward()  # type: ignore[union-attr]
    for tensor in (*(getattr(raster, key) for key in IMAGES), *(t.grad for t in inputs)):
        assert tensor is not None and tensor.isfinite().all()
