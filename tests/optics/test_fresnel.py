"""Fresnel forms against 50-digit arithmetic in the cases where the textbook ratios fail."""

import mpmath
import numpy as np
import pytest
import torch
from mpmath import mp, mpf

from pipeline.optics import fresnel, sphere

ETAS = (1 + 1e-6, 1.001, 1.3, 1.5, 2.3)
BREWSTER = "brewster"
ANGLES_DEG = (0.0, np.degrees(1e-4), 0.5, 30.0, BREWSTER, 80.0, 89.0, 89.99)


def _angle(angle, eta) -> mpf:
    return mpmath.atan(eta) if angle == BREWSTER else mpmath.radians(mpf(angle))


def _truth(theta: mpf, eta: mpf) -> dict[str, mpf]:
    """Fresnel's amplitudes as textbooks print them, at 50 digits."""
    c, s = mpmath.cos(theta), mpmath.sin(theta)
    ct = mpmath.sqrt(1 - (s / eta) ** 2)
    rs = ((c - eta * ct) / (c + eta * ct)) ** 2
    rp = ((eta * c - ct) / (eta * c + ct)) ** 2
    k = s**2
    limit = theta == 0
    return {
        "rs": rs,
        "rp": rp,
        "specular": None if limit else (rs - rp) / (rs + rp) / k,
        "diffuse": None if limit else (rs - rp) / (2 - rs - rp) / k,
        "c": c,
        "sin2": k,
    }


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("eta", ETAS)
def test_every_form_keeps_full_precision_where_ratios_cancel(eta, dtype):
    mp.dps = 50
    tolerance = 3e-7 if dtype is np.float32 else 1e-15
    eta_used = dtype(eta)
    for angle in ANGLES_DEG:
        theta = _angle(angle, mpf(float(eta_used)))
        # The arguments as the pixel has them: rounded cosine and rounded squared sine, both exact inputs of the form.
        c, sin2 = dtype(mpmath.cos(theta)), dtype(mpmath.sin(theta) ** 2)
        t = _truth(theta, mpf(float(eta_used)))
        cos_only = _truth(mpmath.acos(mpf(float(c))), mpf(float(eta_used)))
        c_, s_, e_ = (np.asarray([v], dtype) for v in (c, sin2, eta_used))
        rs, rp = fresnel.reflectances(c_, e_)
        assert rs.dtype == dtype
        assert float(rs[0]) == pytest.approx(float(cos_only["rs"]), rel=8 * tolerance)
        # R_p vanishes at Brewster's angle: held to the unpolarised reflectance there.
        assert float(rp[0]) == pytest.approx(
            float(cos_only["rp"]), rel=8 * tolerance, abs=8 * tolerance * float(cos_only["rs"])
        )
        transmitted = float(fresnel.transmittance(c_, e_)[0])
        assert transmitted == pytest.approx(float(1 - (cos_only["rs"] + cos_only["rp"]) / 2), rel=2 * tolerance)
        if t["specular"] is not None:
            got = float(fresnel.specular_polarisation(c_, s_, e_)[0])
            assert got == pytest.approx(float(t["specular"]), rel=4 * tolerance)
            got = float(fresnel.diffuse_polarisation(c_, e_)[0])
            assert got == pytest.approx(float(t["diffuse"]), rel=8 * tolerance)


def test_energy_is_conserved_for_each_polarisation():
    c = np.linspace(0, 1, 501)[:, None]
    eta = np.linspace(1, 2.5, 31)
    for r, t in zip(fresnel.reflectances(c, eta), fresnel.transmittances(c, eta), strict=True):
        np.testing.assert_allclose(r + t, 1, atol=1e-14)


def test_mirrored_light_is_fully_polarised_at_brewsters_angle():
    eta = np.asarray([1.3, 1.5, 2.3])
    theta = np.arctan(eta)
    sin2 = np.sin(theta) ** 2
    np.testing.assert_allclose(fresnel.specular_polarisation(np.cos(theta), sin2, eta) * sin2, 1, rtol=1e-14)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_values_and_gradients_stay_finite_at_every_edge(dtype):
    c, eta = torch.meshgrid(
        torch.tensor([0.0, 1e-12, 1e-4, 0.5, 1.0], dtype=dtype),
        torch.tensor([1.0, 1 + 1e-6, 1.001, 1.5, 2.3], dtype=dtype),
        indexing="ij",
    )
    c, eta = c.clone().requires_grad_(), eta.clone().requires_grad_()
    sin2 = (1 - c.detach() ** 2).requires_grad_()
    outputs = (
        *fresnel.reflectances(c, eta),
        *fresnel.transmittances(c, eta),
        fresnel.schlick(c, eta),
        fresnel.specular_polarisation(c, sin2, eta),
        fresnel.diffuse_polarisation(c, eta),
        fresnel.hemispherical_transmittance(eta),
    )
    for out in outputs:
        assert torch.isfinite(out).all()
        for gradient in torch.autograd.grad(out.sum(), (c, sin2, eta), allow_unused=True, retain_graph=True):
            assert gradient is None or torch.isfinite(gradient).all()


def test_gradients_equal_finite_differences():
    c = torch.tensor([1e-3, 0.2, 0.7, 1.0], dtype=torch.float64, requires_grad=True)
    eta = torch.tensor([1.01, 1.3, 1.5, 2.2], dtype=torch.float64, requires_grad=True)
    sin2 = torch.tensor([0.9, 0.9, 0.5, 0.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(fresnel.specular_polarisation, (c, sin2, eta))
    assert torch.autograd.gradcheck(fresnel.diffuse_polarisation, (c, eta))
    assert torch.autograd.gradcheck(fresnel.transmittance, (c, eta))
    assert torch.autograd.gradcheck(fresnel.hemispherical_transmittance, (eta,))


def test_schlick_never_leaves_zero_to_one_for_normals_turned_away():
    c = np.linspace(-1, 1.2, 50)
    f = fresnel.schlick(c, np.asarray(1.5))
    assert f.max() <= 1 and f.min() >= 0.04 - 1e-12


@pytest.mark.parametrize("eta,tolerance", [(1.0, 2e-4), (1.05, 2e-4), (1.3, 3e-5), (1.5, 3e-5), (2.5, 3e-5)])
def test_hemispherical_transmittance_equals_quadrature(eta, tolerance):
    d, w = sphere.hemisphere_rule(200, 1)
    truth = np.sum(w * fresnel.transmittance(d[:, 2], np.asarray(eta)) * d[:, 2]) / np.pi
    assert float(fresnel.hemispherical_transmittance(np.asarray(eta))) == pytest.approx(truth, abs=tolerance)


def test_one_source_serves_numpy_torch_and_jax():
    jax = pytest.importorskip("jax")
    c = np.asarray([0.05, 0.4, 0.9], np.float32)
    eta = np.asarray([1.3, 1.5, 2.0], np.float32)
    want = fresnel.transmittance(c, eta)
    np.testing.assert_allclose(fresnel.transmittance(torch.tensor(c), torch.tensor(eta)).numpy(), want, rtol=1e-6)
    got = jax.jit(fresnel.transmittance)(c, eta)
    np.testing.assert_allclose(np.asarray(got), want, rtol=1e-6)
