"""What the CPU kernels promise beyond agreeing with the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.kernels import threads
from stages.train.rasterize import cpu, rasterize

IMAGES = ("features", "alpha", "normal", "depth_expected", "depth_median", "distortion")


def everything(scene, **options) -> list[torch.Tensor]:
    """All images, all gradients, all side outputs."""
    inputs = scene.inputs(torch.float32)
    raster = rasterize(*inputs, *scene.view(torch.float32), **options)
    images = [getattr(raster, name) for name in IMAGES]
    g = torch.Generator().manual_seed(1)
    torch.autograd.backward(images, [torch.randn(i.shape, generator=g) for i in images])
    gradients = [t.grad for t in inputs]
    return [*(i.detach() for i in images), *gradients, raster.screen_gradient, raster.visible, raster.radii]


@pytest.mark.parametrize("count", [1, 3])
def test_bits_repeat_whatever_the_number_of_threads(scene_named, monkeypatch, count) -> None:
    scene = scene_named("crowd")
    first = everything(scene)
    monkeypatch.setattr(threads, "thread_count", lambda: count)
    for one, other in zip(first, everything(scene)):
        assert torch.equal(one, other)


@pytest.mark.parametrize("name", ["plain", "exactly edge-on", "behind", "opaque"])
def test_no_array_is_read_before_it_is_written(scene_named, monkeypatch, name) -> None:
    """The kernels' arrays start uninitialised: filled with NaN beforehand, nothing changes."""
    first = everything(scene_named(name))
    empty = np.empty

    def poisoned(shape, dtype=float, **options):
        array = empty(shape, dtype, **options)
        array.fill(np.nan if array.dtype.kind == "f" else 99)
        return array

    monkeypatch.setattr(np, "empty", poisoned)
    for one, other in zip(first, everything(scene_named(name))):
        assert torch.equal(one, other)


@pytest.mark.parametrize("change", ["none", "behind", "transparent"])
def test_nothing_to_see_is_black_with_zero_gradients(scene_named, change) -> None:
    scene = scene_named("plain")
    means, quats, scales, opacities, features = scene.splats
    if change == "none":
        splats = tuple(t[:0] for t in scene.splats)
    elif change == "behind":
        splats = (means - 9 * scene.camera[2, :3], quats, scales, opacities, features)
    else:
        splats = (means, quats, scales, opacities * 0, features)
    for tensor in everything(replace(scene, splats=splats)):
        assert not tensor.any()


def test_extreme_and_broken_splats_leave_everything_finite_and_the_rest_alone(scene_named) -> None:
    plain = scene_named("plain")
    n = 300
    bad = [t.clone() for t in scene_named("plain").splats]
    inf, nan = float("inf"), float("nan")
    for i, value in enumerate((nan, inf, -inf, 1e30, -1e30)):
        bad[0][i, i % 3] = value
        bad[1][10 + i, i % 4] = value
        bad[2][20 + i, i % 2] = value
        bad[3][30 + i] = value if i != 3 else nan
    bad[1][40] = 0
    bad[1][41] = 1e-30
    bad[1][42] = 1e30
    for i, value in enumerate((0.0, -1.0, 1e-38, 1e-30, 1e-10, 1e10, 1e37)):
        bad[2][50 + i] = value
        bad[2][60 + i, 1] = value
    bad[3][70:74] = torch.tensor([-1.0, 0.0, 1.0, 1.0])
    eye = -plain.camera[:3, :3].T @ plain.camera[:3, 3]
    bad[0][80] = eye  # at the camera itself
    bad[0][81] = eye + 1e-20
    bad[0][82] = eye + plain.camera[0, :3]  # beside it, z = 0
    scene = replace(plain, splats=tuple(torch.cat((t, b)) for t, b in zip(plain.splats, bad)))
    for tensor in everything(scene):
        assert tensor.isfinite().all()
    broken = (0, 10, 20, 30, 40, 50, 51, 70, 71, 80)
    alone = replace(plain, splats=tuple(torch.cat((t, b[list(broken)])) for t, b in zip(plain.splats, bad)))
    result, clean = everything(alone), everything(plain)
    for one, other in zip(result[:6], clean[:6]):
        assert torch.equal(one, other)
    for one, other in zip(result[6:], clean[6:]):
        assert torch.equal(one[:n], other) and not one[n:].any()


@pytest.mark.slow
def test_a_pixel_mask_cuts_images_and_gradients_and_nothing_else(scene_named) -> None:
    scene = scene_named("plain")
    mask = torch.zeros(scene.height, scene.width, dtype=torch.bool)
    mask[5:9, 3:40] = True
    mask[30, 50] = True
    whole_inputs, cut_inputs = scene.inputs(torch.float32), scene.inputs(torch.float32)
    whole = rasterize(*whole_inputs, *scene.view(torch.float32))
    cut = rasterize(*cut_inputs, *scene.view(torch.float32), pixel_mask=mask)
    for name in IMAGES:
        a, b = getattr(whole, name), getattr(cut, name)
        assert torch.equal(a[mask], b[mask]) and not b[~mask].any()
    cotangent = torch.randn(whole.features.shape, generator=torch.Generator().manual_seed(0))
    whole.features.backward(cotangent * mask[..., None])
    cut.features.backward(cotangent)
    for a, b in zip(whole_inputs, cut_inputs):
        assert a.grad is not None and b.grad is not None
        assert torch.allclose(a.grad, b.grad, rtol=1e-4, atol=1e-6)
    reference = rasterize(*scene.inputs(torch.float64), *scene.view(torch.float64), backend="reference", pixel_mask=mask)
    assert torch.allclose(reference.features.float(), cut.features, atol=1e-4)


def test_one_compilation_serves_every_call(scene_named) -> None:
    """Scenes of other sizes, dtypes, channel counts, masks and missing cotangents use the code already compiled."""
    for name in ("plain", "no channels", "many channels", "off-centre", "one pixel"):
        everything(scene_named(name))
    scene = scene_named("plain")
    inputs = scene.inputs(torch.float64)
    mask = torch.rand(scene.width, scene.height).T > 0.5  # not contiguous
    raster = rasterize(*inputs, *scene.view(torch.float64), pixel_mask=mask, near=0.1, screen_filter=False)
    raster.alpha.sum().backward()
    assert inputs[0].grad is not None and inputs[0].grad.dtype == torch.float64
    for name in ("project", "depth_order", "bin_splats", "blend_tiles", "tiles_backward", "project_backward"):
        assert len(getattr(cpu, name).signatures) == 1, name


def test_fixed_inputs_get_no_gradient_and_the_rest_do(scene_named) -> None:
    scene = scene_named("plain")
    inputs = scene.inputs(torch.float32)
    inputs[1] = inputs[1].detach()
    raster = rasterize(*inputs, *scene.view(torch.float32))
    raster.depth_median.sum().backward()
    assert inputs[1].grad is None
    assert inputs[0].grad is not None and inputs[0].grad.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scales": torch.ones(300, 3)}, "scales has shape"),
        ({"features": torch.ones(300)}, "features has shape"),
        ({"opacities": torch.ones(300, dtype=torch.int64)}, "opacities has dtype"),
        ({"backend": "metal"}, "metal"),
        ({"near": 0.0}, "near must be positive"),
        ({"pixel_mask": torch.ones(3, 3, dtype=torch.bool)}, "pixel_mask"),
        ({"intrinsics": torch.eye(3) + torch.ones(3, 3)}, "no skew"),
    ],
)
def test_wrong_arguments_are_named(scene_named, change, message) -> None:
    scene = scene_named("plain")
    names = ("means", "quats", "scales", "opacities", "features")
    arguments = dict(zip(names, scene.splats), world_to_camera=scene.camera, intrinsics=scene.intrinsics)
    with pytest.raises(ValueError, match=message):
        rasterize(**{**arguments, "width": 60, "height": 40, **change})
