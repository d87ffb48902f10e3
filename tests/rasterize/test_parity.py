"""The CPU kernels are the reference, in images and in every gradient, on ordinary and on hostile scenes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from stages.train.rasterize import rasterize
from stages.train.rasterize.cuda import enlarged, thinned

IMAGES = ("features", "alpha", "normal", "depth_expected", "depth_median", "distortion")
INPUTS = ("means", "quats", "scales", "opacities", "features")

# Relative 2-norm errors of float32 against float64: three times the largest measured over the ordinary scenes (images
# 9e-6; gradients 2.3e-4, from steep splats near their horizon), then by name, with the measured value beside.
IMAGE_TOLERANCE = {
    "needles": 6e-3,  # 1.7e-3: 0.01 px wide, so the rounding of a pixel's place moves alpha
    "edge-on": 2e-4,  # 6.5e-5: down to 0.01 degrees, where n.p keeps four digits
}
GRADIENT_TOLERANCE = {"needles": 1.5e-2, "edge-on": 1.5e-2}  # 4.6e-3, 5.6e-3
# A sum of squares minus a squared sum: rounding of alpha * m2, in units of the squared distance, where the truth is 0.
DISTORTION_FLOOR = 1e-6


def run(scene, backend: str, dtype: torch.dtype, screen_filter: int, images=IMAGES, layer: float = 0.0) -> dict[str, Tensor]:
    """Images, gradients for random cotangents (the same for both backends), and side outputs, all float64."""
    inputs = scene.inputs(dtype)
    raster = rasterize(*inputs, *scene.view(dtype), backend=backend, screen_filter=screen_filter, layer=layer)
    distance = float(scene.camera[:3, 3].norm())
    units = {"depth_expected": distance, "depth_median": distance, "distortion": distance**2}
    g = torch.Generator().manual_seed(5)
    loss = torch.zeros((), dtype=dtype)
    results = {}
    for name in images:
        image = getattr(raster, name) / units.get(name, 1.0)
        results[name] = image.detach()
        loss = loss + (image * torch.randn(image.shape, generator=g).to(dtype)).sum()
    loss.backward()
    for name, tensor in zip(INPUTS, inputs):
        results[f"d {name}"] = torch.zeros_like(tensor) if tensor.grad is None else tensor.grad
    results |= {name: getattr(raster, name) for name in ("screen_gradient", "visible", "radii")}
    return {name: value.double() for name, value in results.items()}


def relative_error(value: Tensor, truth: Tensor, floor: float = 0.0) -> float:
    size = float(truth.norm()) + floor * truth.numel() ** 0.5
    return float((value - truth).norm()) / size if size else float((value - truth).norm())


@pytest.mark.parametrize(("screen_filter", "layer"), [(1, 0.0), (2, 0.0), (0, 0.0), (2, 0.1), (1, 0.7)])
def test_cpu_equals_reference(scene, request, screen_filter, layer) -> None:
    name = request.node.callspec.params["scene"]
    # the side of a splat seen exactly edge-on is decided by rounding, so its normal is left out there
    images = tuple(i for i in IMAGES if not (name == "exactly edge-on" and i == "normal"))
    truth = run(scene, "reference", torch.float64, screen_filter, images, layer)
    value = run(scene, "cpu", torch.float32, screen_filter, images, layer)
    for key, expected in truth.items():
        assert value[key].isfinite().all(), key
        is_gradient = key.startswith("d ") or key in ("screen_gradient", "radii")
        tolerance = GRADIENT_TOLERANCE.get(name, 7e-4) if is_gradient else IMAGE_TOLERANCE.get(name, 3e-5)
        error = relative_error(value[key], expected, DISTORTION_FLOOR if key == "distortion" else 0.0)
        assert error <= tolerance, f"{key}: {error:.1e} > {tolerance:.1e}"


def test_a_narrower_filter_is_the_usual_one_on_an_enlarged_image(scene) -> None:
    """How the gsplat backend gets it: its filter is fixed in pixels."""
    inputs = scene.inputs(torch.float32)
    camera, lens, width, height = scene.view(torch.float32)
    mask = torch.rand(height, width, generator=torch.Generator().manual_seed(2)) > 0.3
    narrow = rasterize(*inputs, camera, lens, width, height, screen_filter=3, pixel_mask=mask)
    large_lens, large_mask = enlarged(lens, mask, 3)
    large = rasterize(*inputs, camera, large_lens, 3 * width, 3 * height, pixel_mask=large_mask)
    small = thinned(large, 3)
    for name in ("features", "alpha", "depth_expected"):
        assert relative_error(getattr(small, name).detach(), getattr(narrow, name).detach()) < 1e-3, name


@pytest.mark.slow
@pytest.mark.parametrize("image", IMAGES)
@pytest.mark.parametrize("channels", [5, 8])
def test_an_image_left_out_of_the_loss_changes_nothing(scene_named, image, channels) -> None:
    """Cotangents that are missing are zeros: with one image alone, and with the padding of 5 channels and none of 8."""
    means, quats, scales, opacities, features = scene_named("plain").splats
    features = features.repeat(1, 2)[:100, :channels]
    scene = replace(scene_named("plain"), splats=(means[:100], quats[:100], scales[:100], opacities[:100], features))
    truth = run(scene, "reference", torch.float64, True, (image,))
    value = run(scene, "cpu", torch.float32, True, (image,))
    for key, expected in truth.items():
        assert relative_error(value[key], expected) <= 7e-4, key


def test_scenes_are_not_trivial(scene_named) -> None:
    """Guards the test above: most scenes fill pixels, and every gradient there is large somewhere."""
    for name in ("plain", "edge-on", "needles", "huge", "behind", "covering", "off-centre"):
        result = run(scene_named(name), "cpu", torch.float32, True)
        assert result["alpha"].max() > 0.5, name
        for key in INPUTS:
            assert (result[f"d {key}"].abs() > 1e-3).sum() >= 10, (name, key)


@pytest.mark.parametrize("layer", [0.0, 0.1])
@pytest.mark.parametrize("factor", [1e-3, 1e4])
def test_scene_scale_changes_nothing_but_distances(scene_named, factor, layer) -> None:
    plain = scene_named("plain")
    sides = ((plain, layer), (plain.scaled(factor), factor * layer))
    one, other = (run(scene, "cpu", torch.float32, True, layer=depth) for scene, depth in sides)
    for key in (*IMAGES, "visible", "radii"):  # depths are in units of the camera's distance here
        assert relative_error(other[key], one[key]) < 3e-5, key  # measured 4e-6
    assert relative_error(other["d means"] * factor, one["d means"]) < 7e-4  # measured 2.1e-4
    assert relative_error(other["d scales"] * factor, one["d scales"]) < 3e-5
