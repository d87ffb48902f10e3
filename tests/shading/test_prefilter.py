"""Prefiltered levels against brute-force integrals over the same environment."""

import numpy as np
import pytest
import torch

from pipeline.optics import fresnel, microfacet, sphere
from pipeline.shading import Prefilter, cube, latlong
from pipeline.shading.prefilter import pyramid
from pipeline.shading.symmetry import texel_images

RESOLUTION = 32


def _fine(texels: np.ndarray, sub: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions, solid angles and radiance of texels cut into sub x sub."""
    size = texels.shape[1] * sub
    d = cube.cube_directions(size).reshape(-1, 3)
    w = np.tile(sphere.cube_solid_angles(size).ravel(), 6)
    return d, w, texels.repeat(sub, 1).repeat(sub, 2).reshape(-1, 3)


@pytest.fixture(scope="module")
def case(environment):
    texels = latlong.to_cube(environment, RESOLUTION)
    directions = np.random.default_rng(2).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return texels, _fine(texels, 2), directions


@pytest.mark.slow
@pytest.mark.parametrize("lobe", ["ggx", "beckmann"])
def test_mirror_levels_equal_the_lobe_integral(case, lobe):
    texels, (d, w, radiance), directions = case
    light = Prefilter(RESOLUTION, lobe).apply(torch.as_tensor(texels))
    for roughness, tolerance in ((0.2, 0.03), (0.25, 0.03), (0.42, 0.02), (1.0, 0.02)):
        cosine = np.maximum(directions @ d.T, 0)
        nh = np.sqrt((1 + cosine) / 2)
        kernel = microfacet.DISTRIBUTIONS[lobe](nh, np.asarray(roughness**2)) * cosine * w
        truth = kernel @ radiance / kernel.sum(1, keepdims=True)
        got = light.mirrored(torch.as_tensor(directions), torch.full((100,), roughness).double()).numpy()
        relative = np.abs(got - truth).mean(1) / truth.mean(1)
        assert np.median(relative) < tolerance, (roughness, np.median(relative))
        assert np.percentile(relative, 95) < 8 * tolerance, (roughness, np.percentile(relative, 95))


def test_irradiance_equals_the_cosine_integral_with_and_without_transmission(case):
    texels, (d, w, radiance), directions = case
    light = Prefilter(RESOLUTION).apply(torch.as_tensor(texels))
    cosine = np.maximum(directions @ d.T, 0)
    entering = np.where(cosine > 0, fresnel.transmittance(cosine, np.asarray(1.5)), 0)
    for transmitted, kernel in ((False, cosine), (True, cosine * entering)):
        truth = (kernel * w) @ radiance
        got = light.irradiance(torch.as_tensor(directions), transmitted=transmitted).numpy()
        relative = np.abs(got - truth).mean(1) / truth.mean(1)
        assert np.median(relative) < 0.005 and relative.max() < 0.1


@pytest.mark.parametrize("lobe", ["ggx", "beckmann"])
@pytest.mark.parametrize("resolution", [4, 16, 32])
def test_a_constant_environment_stays_constant_and_gives_pi_times_its_radiance(lobe, resolution):
    light = Prefilter(resolution, lobe).apply(torch.full((6, resolution, resolution, 3), 2.0))
    for level in light.specular:
        torch.testing.assert_close(level.of(light.packed), torch.full_like(level.of(light.packed), 2.0))
    cosine = light.cosine.of(light.packed)
    torch.testing.assert_close(cosine, torch.full_like(cosine, 2 * np.pi))


def test_filtering_commutes_with_every_symmetry_of_the_cube(case):
    texels = torch.as_tensor(case[0])
    prefilter = Prefilter(RESOLUTION)
    packed = prefilter.apply(texels).packed
    for k in (7, 30):
        moved = torch.empty_like(texels.reshape(-1, 3))
        moved[torch.as_tensor(texel_images(RESOLUTION)[k]).long()] = texels.reshape(-1, 3)
        turned = prefilter.apply(moved.reshape(texels.shape)).packed
        for level in prefilter.levels:
            n = level.resolution
            where = torch.as_tensor(texel_images(n)[k]).long()
            torch.testing.assert_close(level.of(turned)[where], level.of(packed)[: 6 * n * n])


def test_fused_product_and_its_transpose_equal_the_plain_ones():
    prefilter = Prefilter(RESOLUTION)
    g = torch.Generator().manual_seed(0)
    radiance = torch.rand(6, RESOLUTION, RESOLUTION, 3, generator=g)
    cotangent = torch.randn(prefilter.operator.size, 3, generator=g)
    outputs, gradients = [], []
    for dtype in (torch.float32, torch.float64):
        x = radiance.to(dtype).clone().requires_grad_()
        y = prefilter.apply(x).packed
        y.backward(cotangent.to(dtype))
        outputs.append(y.detach().double())
        gradients.append(x.grad.double())
    torch.testing.assert_close(*outputs, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(*gradients, rtol=1e-4, atol=1e-5)


def test_pyramid_conserves_light():
    texels = torch.rand(6, 16, 16, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    stacked, start = pyramid(texels), 0
    want = np.einsum("fjic,ji->c", texels.numpy(), sphere.cube_solid_angles(16))
    for n in (16, 8, 4):
        level = stacked[start : start + 6 * n * n].reshape(6, n, n, 3).numpy()
        np.testing.assert_allclose(np.einsum("fjic,ji->c", level, sphere.cube_solid_angles(n)), want)
        start += 6 * n * n


def test_a_sun_of_1e5_keeps_its_energy_and_neighbours_stay_finite():
    texels = torch.full((6, RESOLUTION, RESOLUTION, 3), 0.1)
    texels[2, 10, 10] = 1e5
    light = Prefilter(RESOLUTION).apply(texels)
    assert torch.isfinite(light.packed).all() and light.packed.min() > 0.099
    truth = np.einsum("fjic,ji->c", texels.numpy(), sphere.cube_solid_angles(RESOLUTION))
    for level in light.specular:
        n = level.resolution
        held = level.of(light.packed)[: 6 * n * n].reshape(6, n, n, 3).numpy()
        np.testing.assert_allclose(np.einsum("fjic,ji->c", held, sphere.cube_solid_angles(n)), truth, rtol=0.02)


def test_unusable_resolutions_and_lobes_are_refused_by_name():
    with pytest.raises(ValueError, match="33"):
        Prefilter(33)
    with pytest.raises(ValueError, match="phong"):
        Prefilter(32, "phong")


def test_mirrored_light_without_a_gradient_is_that_of_torch():
    """One pass of a kernel, from the sharpest level to past the roughest; with a gradient it stays torch's."""
    draw = torch.Generator().manual_seed(3)
    light = Prefilter(16, "beckmann").apply(torch.rand(6, 16, 16, 3, generator=draw))
    directions = torch.nn.functional.normalize(torch.randn(500, 3, generator=draw), dim=-1)
    roughness = torch.linspace(0, 1.1, 500)
    wanted = light.mirrored_plainly(directions, roughness)
    assert torch.allclose(light.mirrored(directions, roughness), wanted, atol=2e-5)
    assert light.mirrored(directions.requires_grad_(True), roughness).requires_grad
