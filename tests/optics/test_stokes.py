"""Round trips of polarised light through frames, polarisers and surfaces."""

import numpy as np
import pytest

from pipeline.optics import fresnel, mueller, stokes

RNG = np.random.default_rng(5)


def _light(n: int) -> np.ndarray:
    degree, angle = RNG.uniform(0, 1, n), RNG.uniform(-np.pi / 2, np.pi / 2, n)
    s0 = RNG.uniform(0.1, 5, n)
    return np.stack((s0, s0 * degree * np.cos(2 * angle), s0 * degree * np.sin(2 * angle)), -1)


def test_stokes_survive_a_round_trip_through_polariser_intensities():
    s = _light(100)
    for angles in ((0, 45, 90), (0, 45, 90, 135), (3, 77, 140)):
        a = stokes.polariser_row(np.radians(np.asarray(angles, float)), extinction=300.0)
        back = np.linalg.lstsq(a, a @ s.T, rcond=None)[0].T
        np.testing.assert_allclose(back, s, rtol=1e-12, atol=1e-12)


def test_signs_of_s1_and_s2_follow_the_displayed_image():
    horizontal, diagonal = np.asarray([1.0, 1.0, 0.0]), np.asarray([1.0, 0.0, 1.0])
    at = lambda s, deg: float(stokes.polariser_row(np.asarray(np.radians(deg))) @ s)  # noqa: E731
    assert at(horizontal, 0) == pytest.approx(1) and at(horizontal, 90) == pytest.approx(0)
    assert at(diagonal, 45) == pytest.approx(1) and at(diagonal, 135) == pytest.approx(0)
    assert np.degrees(stokes.angle(diagonal)) == pytest.approx(45)


def test_turning_the_frame_turns_the_angle_and_keeps_the_degree():
    s = _light(50)
    phi = np.asarray(0.3)
    turned = np.einsum("ij,nj->ni", mueller.rotation(phi), s)
    np.testing.assert_allclose(stokes.degree(turned), stokes.degree(s), rtol=1e-12)
    np.testing.assert_allclose(stokes.angle_difference(stokes.angle(turned), stokes.angle(s) - 0.3), 0, atol=1e-12)


def test_degree_is_zero_without_light_and_may_exceed_one_from_noise():
    s = np.asarray([[0.0, 0.1, 0.0], [-1.0, 0.5, 0.5], [1.0, 1.2, 0.0]])
    np.testing.assert_allclose(stokes.degree(s), [0, 0, 1.2])


def test_mueller_reflection_agrees_with_the_polarisation_ratios():
    theta = np.radians(np.asarray([5.0, 40.0, 56.31, 80.0]))
    eta = np.asarray(1.5)
    m = mueller.reflection(np.cos(theta), eta)
    s = m[..., 0]  # unpolarised light in
    sin2 = np.sin(theta) ** 2
    np.testing.assert_allclose(s[:, 0], fresnel.reflectance(np.cos(theta), eta), rtol=1e-12)
    want = -fresnel.specular_polarisation(np.cos(theta), sin2, eta) * sin2
    np.testing.assert_allclose(s[:, 1] / s[:, 0], want, rtol=1e-12)
    t = mueller.transmission(np.cos(theta), eta)[..., 0]
    want = fresnel.diffuse_polarisation(np.cos(theta), eta) * sin2
    np.testing.assert_allclose(t[:, 1] / t[:, 0], want, rtol=1e-12)
    np.testing.assert_allclose(t[:, 0] + s[:, 0], 1, rtol=1e-12)


def test_polariser_matrix_is_a_projector_when_ideal_and_passes_half_when_useless():
    p = mueller.polariser(np.asarray(0.7))
    np.testing.assert_allclose(p @ p, p, atol=1e-12)
    np.testing.assert_allclose(mueller.polariser(np.asarray(0.7), 1.0), np.eye(3) / 2, atol=1e-12)


def test_surface_pattern_is_sine_squared_times_the_doubled_azimuth():
    x, y = np.asarray([1.0, 0, 0]), np.asarray([0.0, 1, 0])
    theta, phi = 0.8, 2.1
    n = np.asarray([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    c2, s2 = stokes.surface_pattern(n, x, y)
    assert float(c2) == pytest.approx(np.sin(theta) ** 2 * np.cos(2 * phi))
    assert float(s2) == pytest.approx(np.sin(theta) ** 2 * np.sin(2 * phi))
