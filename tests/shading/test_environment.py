"""Cube maps: geometry, seams, activation, and conversion to and from latitude-longitude maps."""

import numpy as np
import pytest
import torch

from pipeline.optics import sphere
from pipeline.shading import EnvironmentCube, cube, latlong
from pipeline.shading.environment import activate, deactivate


def _integral_cube(c: np.ndarray) -> np.ndarray:
    return np.einsum("fjic,ji->c", c, sphere.cube_solid_angles(c.shape[1]))


def _integral_latlong(image: np.ndarray) -> np.ndarray:
    return np.einsum("hwc,h->c", image, sphere.latlong_solid_angles(*image.shape[:2]))


@pytest.mark.parametrize("shape,resolution", [((64, 128), 16), ((64, 128), 64), ((37, 50), 8)])
def test_latlong_and_cube_hold_the_same_light(shape, resolution):
    rng = np.random.default_rng(3)
    image = rng.uniform(0, 1, (*shape, 3))
    image[5, 7] = 1e5  # a sun of one pixel
    texels = latlong.to_cube(image, resolution)
    np.testing.assert_allclose(_integral_cube(texels), _integral_latlong(image), rtol=1e-10)
    back = latlong.from_cube(texels, *shape)
    np.testing.assert_allclose(_integral_latlong(back), _integral_latlong(image), rtol=1e-10)
    assert back.min() >= 0
    np.testing.assert_allclose(latlong.to_cube(np.ones((*shape, 1)), resolution), 1, atol=5e-3)


def test_latlong_convention_is_the_contracts():
    # +y at the top; u = atan2(x, -z)/2pi: -z in column 0, +x a quarter, +z half way.
    d = latlong.directions(64, 128)[:, :, 0]
    np.testing.assert_allclose(d[0].mean(0), [0, 1, 0], atol=0.03)
    for column, axis in ((0, [0, 0, -1]), (32, [1, 0, 0]), (64, [0, 0, 1]), (96, [-1, 0, 0])):
        np.testing.assert_allclose(d[32, column], axis, atol=0.04)


def test_a_bright_texel_lands_where_it_points():
    texels = np.zeros((6, 16, 16, 1))
    texels[2, 3, 9] = 1.0
    image = latlong.from_cube(texels, 128, 256)[..., 0]
    row, column = np.unravel_index(image.argmax(), image.shape)
    cosine = latlong.directions(128, 256)[row, column, 0] @ cube.cube_directions(16)[2, 3, 9]
    assert np.degrees(np.arccos(cosine)) < 4


def test_round_trip_through_the_environment_keeps_the_picture(environment):
    cube = EnvironmentCube(64, torch.as_tensor(latlong.to_cube(environment, 64)))
    back = latlong.from_cube(cube.radiance().detach().numpy(), 64, 128)
    assert back.shape == (64, 128, 3)
    smooth = environment.max(-1) < 3
    assert np.abs(back - environment)[smooth].mean() < 0.02


def test_lookup_is_exact_at_texel_centres_and_continuous_over_edges_and_corners():
    rng = np.random.default_rng(0)
    texels = torch.as_tensor(rng.normal(size=(6, 8, 8, 3)))
    table = cube.extend(texels)
    centres = torch.as_tensor(cube.cube_directions(8).reshape(-1, 3))
    torch.testing.assert_close(cube.lookup(table, centres, 8), texels.reshape(-1, 3))
    d = rng.normal(size=(4000, 3))
    d[:2000, 1] = np.abs(d[:2000, 0])  # on an edge of two faces
    d[2000:] = np.sign(d[2000:])  # on a corner of three
    step = 1e-9 * rng.normal(size=d.shape)
    a, b = (cube.lookup(table, torch.as_tensor(x), 8) for x in (d, d + step))
    assert (a - b).abs().max() < 1e-5


def test_lookup_gradients_equal_finite_differences():
    g = torch.Generator().manual_seed(1)
    table = cube.extend(torch.rand(6, 4, 4, 2, generator=g, dtype=torch.float64)).requires_grad_()
    d = torch.randn(20, 3, generator=g, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t, x: cube.lookup(t, x, 4), (table, d))


def test_activation_is_positive_invertible_and_slopes_everywhere():
    raw = torch.linspace(-12, 100, 2001, dtype=torch.float64, requires_grad=True)
    radiance = activate(raw)
    assert (radiance > 0).all()
    torch.testing.assert_close(deactivate(radiance), raw)
    assert (torch.autograd.grad(radiance.sum(), raw)[0] > 0).all()
    assert float(activate(torch.zeros(1))) == 0.5
    assert torch.isfinite(deactivate(torch.tensor([0.0, 1e5]))).all()
