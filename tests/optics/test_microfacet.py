"""Microfacet lobes and spherical quadrature: normalisation, shadowing, solid angles."""

import numpy as np
import pytest
import torch

from pipeline.optics import microfacet, sphere


@pytest.mark.parametrize("lobe", ["ggx", "beckmann"])
@pytest.mark.parametrize("roughness", [0.08, 0.3, 1.0])
def test_projected_facets_cover_the_surface_once(lobe, roughness):
    alpha = roughness**2
    # t = tan/alpha mapped to [0, 1): nodes follow the lobe at every roughness
    x, w = np.polynomial.legendre.leggauss(100)
    u, w = (x + 1) / 2, w / 2
    t = alpha * u / (1 - u)
    c = 1 / np.sqrt(1 + t * t)
    area = 2 * np.pi * t * c**4 * alpha / (1 - u) ** 2 * w  # cos(theta) d omega
    assert np.sum(microfacet.DISTRIBUTIONS[lobe](c, np.asarray(alpha)) * area) == pytest.approx(1, abs=2e-6)


@pytest.mark.parametrize("alpha", [0.0064, 0.1, 1.0])
def test_beckmann_lambda_fit_stays_near_the_closed_form(alpha):
    for c in (1e-3, 0.05, 0.3, 0.8, 1.0):
        g = 1 / (1 + microfacet.beckmann_lambda_exact(c, alpha))
        fit = float(microfacet.masking(np.asarray(c), np.asarray(alpha), "beckmann"))
        assert fit == pytest.approx(g, rel=5e-3)


@pytest.mark.parametrize("lobe", ["ggx", "beckmann"])
def test_lobes_have_finite_gradients_at_normal_incidence_and_grazing(lobe):
    c = torch.tensor([1.0, 0.5, 1e-4], requires_grad=True)
    alpha = torch.tensor([0.0064, 0.1, 1.0], requires_grad=True)
    out = microfacet.DISTRIBUTIONS[lobe](c, alpha).sum() + microfacet.masking(c, alpha, lobe).sum()
    assert all(torch.isfinite(g).all() for g in torch.autograd.grad(out, (c, alpha)))


@pytest.mark.parametrize("resolution", [1, 5, 64])
def test_solid_angles_of_cube_and_latlong_cover_the_sphere(resolution):
    assert 6 * sphere.cube_solid_angles(resolution).sum() == pytest.approx(4 * np.pi, rel=1e-13)
    rows = sphere.latlong_solid_angles(resolution, 2 * resolution)
    assert rows.sum() * 2 * resolution == pytest.approx(4 * np.pi, rel=1e-13)


def test_sphere_rules_integrate_polynomials_exactly():
    d, w = sphere.sphere_rule(6)
    assert w.sum() == pytest.approx(4 * np.pi)
    assert np.sum(w * d[:, 0] ** 4 * d[:, 1] ** 2) == pytest.approx(4 * np.pi * 3 / 105)
    d, w = sphere.hemisphere_rule(4, 8)
    assert np.sum(w * d[:, 2]) == pytest.approx(np.pi)
