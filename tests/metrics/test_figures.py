"""Every figure on a case worked by hand, and against other people's code."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from stages.metrics.environment_figures import environment_figures, row_weights
from stages.metrics.hdr_flip import exposures, hdr_flip
from stages.metrics.image_figures import (
    angle_deg,
    dolp_aolp,
    erode,
    normal_figures,
    polarisation_figures,
    psnr,
    radiance_figures,
    ssim_map,
)
from stages.metrics.mesh_figures import sample, surface_figures
from stages.metrics.relight_figures import relight_figures
from stages.metrics.table import Table
from synth.environments import meadow, studio


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def stokes_image(degree: float, angle_deg: float, size: int = 4) -> np.ndarray:
    """A uniform grey Stokes image of radiance 1/2."""
    angle = 2 * np.radians(angle_deg)
    vector = 0.5 * np.array([1.0, degree * np.cos(angle), degree * np.sin(angle)])
    return np.broadcast_to(vector[:, None], (size, size, 3, 3)).astype(np.float32)


def test_flipped_normal_is_180_degrees():
    up = np.array([[[0.0, 0, 1]]])
    assert angle_deg(up, -up)[0, 0] == pytest.approx(180)
    assert angle_deg(up, up)[0, 0] == 0
    assert angle_deg(up, np.array([[[1.0, 0, 0]]]))[0, 0] == pytest.approx(90)
    figures = normal_figures(up, -up, np.ones((1, 1), bool))
    assert figures == pytest.approx({"normal_mae_deg": 180, "normal_cosine_distance": 2})


def test_small_angles_keep_their_digits():
    tilted = np.array([[[np.sin(1e-4), 0, np.cos(1e-4)]]])
    assert angle_deg(np.array([[[0.0, 0, 1]]]), tilted)[0, 0] == pytest.approx(np.degrees(1e-4), rel=1e-6)


def test_missing_normal_counts_as_90_degrees():
    truth = np.array([[[0.0, 0, 1]]])
    assert normal_figures(0 * truth, truth, np.ones((1, 1), bool))["normal_mae_deg"] == 90


def test_psnr_of_a_known_offset_and_of_equal_images():
    a = np.full((8, 8, 3), 0.5, np.float32)
    assert psnr(a, a + 0.1) == pytest.approx(20, abs=1e-5)
    assert psnr(a, a) == 120


def test_psnr_agrees_with_scikit_image(rng):
    metrics = pytest.importorskip("skimage.metrics")
    a = rng.random((40, 50, 3)).astype(np.float32)
    b = np.clip(a + 0.1 * rng.standard_normal(a.shape), 0, 1).astype(np.float32)
    assert psnr(a, b) == pytest.approx(metrics.peak_signal_noise_ratio(a, b, data_range=1), abs=1e-4)


@pytest.mark.parametrize("size", [(40, 50), (11, 12), (3, 7), (1, 1)])
def test_ssim_is_that_of_its_definition_also_in_frames_smaller_than_its_window(rng, size):
    a = rng.random((*size, 3)).astype(np.float32)
    b = np.clip(a + 0.1 * rng.standard_normal(a.shape), 0, 1).astype(np.float32)

    def blur(z):
        return gaussian_filter(z, (1.5, 1.5, 0), truncate=3.5)

    x, y = a.astype(float), b.astype(float)
    mx, my = blur(x), blur(y)
    vx, vy, vxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    defined = (2 * mx * my + 1e-4) * (2 * vxy + 9e-4) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4))
    assert np.abs(ssim_map(a, b) - defined).max() < 1e-9


def test_mask_limits_the_foreground_figure():
    a, b = np.zeros((4, 4, 3), np.float32), np.zeros((4, 4, 3), np.float32)
    b[0, 0] = 1
    mask = np.zeros((4, 4), bool)
    mask[2:] = True
    figures = radiance_figures(a, b, mask)
    assert figures["psnr_foreground"] == 120
    assert figures["psnr_srgb"] == pytest.approx(10 * np.log10(16), abs=1e-4)


@pytest.mark.parametrize(("first", "second", "error"), [(10, 30, 20), (89, -89, 2), (0, 90, 90), (45, 45, 0)])
def test_aolp_error_is_modulo_180(first, second, error):
    figures = polarisation_figures(stokes_image(0.5, first), stokes_image(0.5, second), np.ones((4, 4), bool))
    assert figures["aolp_mae_deg"] == pytest.approx(error, abs=1e-3)
    assert figures["dolp_mae"] == pytest.approx(0, abs=1e-6)


def test_dolp_of_black_is_zero_and_aolp_ignores_unpolarised_pixels():
    degree, _ = dolp_aolp(np.zeros((2, 2, 3, 3), np.float32))
    assert (degree == 0).all()
    assert "aolp_mae_deg" not in polarisation_figures(stokes_image(0.5, 0), stokes_image(0.01, 0), np.ones((4, 4), bool))


def test_erosion_takes_one_pixel_a_round():
    mask = np.zeros((9, 9), bool)
    mask[2:7, 2:7] = True
    assert erode(mask, 1).sum() == 9
    assert erode(mask, 2).sum() == 1


def test_environment_equal_to_truth_is_perfect_and_scale_is_found():
    truth = meadow(64)
    same = environment_figures(truth, truth)
    assert same["env_psnr"] == 120
    assert same["env_log_correlation"] == pytest.approx(1)
    brighter = environment_figures(3 * truth, truth)
    assert brighter["env_psnr_scaled"] > brighter["env_psnr"] + 5
    assert environment_figures(studio(64), truth)["env_log_correlation"] < 0.7


def test_environment_rows_count_by_solid_angle():
    weights = row_weights(64)
    assert weights.mean() == pytest.approx(1)
    assert weights[0] == pytest.approx(np.sin(0.5 / 64 * np.pi) * 64 / (2 / np.sin(np.pi / 128)) * 2, rel=1)
    assert weights[0] < 0.05 < 1.5 < weights[32]


def quad(z: float) -> tuple[np.ndarray, np.ndarray]:
    """A unit square at height z as two triangles."""
    vertices = np.array([(0, 0, z), (1, 0, z), (1, 1, z), (0, 1, z)], float)
    return vertices, np.array([(0, 1, 2), (0, 2, 3)])


def test_distance_of_parallel_squares_is_their_offset():
    figures = surface_figures(quad(0.2), quad(0.0), 20000)
    assert figures["chamfer_pct"] == pytest.approx(20, abs=0.1)
    assert figures["fscore_1pct"] == pytest.approx(1e-9)
    same = surface_figures(quad(0.0), quad(0.0), 20000)
    assert same["chamfer_pct"] < 0.6  # the spacing of the samples
    assert same["fscore_1pct"] > 0.95


def test_samples_are_uniform_by_area(rng):
    vertices = np.array([(0, 0, 0), (3, 0, 0), (0, 1, 0), (-1, 0, 0)], float)
    points = sample(vertices, np.array([(0, 1, 2), (0, 2, 3)]), 40000, rng)
    assert (points[:, 0] > 0).mean() == pytest.approx(0.75, abs=0.01)
    assert points[points[:, 0] > 0].mean(0)[:2] == pytest.approx([1, 1 / 3], abs=0.02)


def test_relight_scale_is_per_channel(rng):
    truth = 0.4 * rng.random((16, 16, 3))
    everywhere = np.ones((16, 16), bool)
    figures = relight_figures(truth / np.array([2.0, 1.0, 0.5]), truth, everywhere)
    assert [figures[f"scale_{c}"] for c in "rgb"] == pytest.approx([2, 1, 0.5], rel=2e-4)
    assert figures["psnr_srgb_scaled"] > 75
    assert relight_figures(0 * truth, truth, everywhere)["scale_r"] == 0


def test_best_scale_never_scores_worse_than_none(rng):
    # Lamps past white weigh most in radiance: there least squares asks for a factor that spoils everything else.
    truth = 0.3 * rng.random((24, 24, 3))
    image = truth.copy()
    truth[:4], image[:4] = 40.0, 8.0
    inside = np.ones((24, 24), bool)
    inside[:, :6] = False
    figures = relight_figures(image, truth, inside)
    assert figures["psnr_srgb_scaled"] >= figures["psnr_srgb"] > 100
    assert figures["psnr_foreground_scaled"] >= figures["psnr_foreground"]


def test_foreground_of_relit_images_is_what_the_mask_covers(rng):
    truth = rng.random((16, 16, 3))
    image = truth.copy()
    image[:8] += 0.1
    inside = np.zeros((16, 16), bool)
    inside[8:] = True
    figures = relight_figures(image, truth, inside)
    assert figures["psnr_foreground"] == 120 and figures["psnr_srgb"] < 40
    assert 0 < figures["hdr_flip_foreground"] < figures["hdr_flip"]


def test_hdr_flip_sees_highlights_at_every_exposure_and_not_the_frame_around_the_object(rng):
    truth = np.zeros((48, 48, 3))
    truth[12:36, 12:36] = 0.2 + 0.1 * rng.random((24, 24, 1))
    truth[20:24, 20:24] = 30.0
    shown = truth.any(-1)
    first, last = exposures(truth, shown)
    white = 2 ** (first + np.log2(30))  # the tone mapper takes it to 0.85
    assert (0.9036 * white**2 + 0.018 * white) / (0.8748 * white**2 + 0.354 * white + 0.14) == pytest.approx(0.85)
    assert last - first == pytest.approx(np.log2(30 / np.median(truth[shown][:, 0])), abs=1e-3)
    blown = truth.copy()
    blown[20:22, 20:24] = 15.0  # both past white at the usual exposure
    error = hdr_flip(blown, truth, shown)
    assert error[20:22, 20:24].mean() > 0.1 and error[:4].max() == pytest.approx(0, abs=1e-4)
    assert hdr_flip(truth, truth, shown).max() == pytest.approx(0, abs=1e-4)
    assert hdr_flip(truth, 0 * truth, shown) is None


def test_table_says_why_a_figure_is_null():
    table = Table({"psnr_srgb": 30.0, "odd": float("nan")}, [{"view": "a", "x": 1.0}, {"view": "b", "x": 3.0}])
    table.means()
    table.missing(["psnr_srgb", "chamfer_pct"], "no truth")
    out = table.as_json()
    assert out["x"] == 2
    assert out["chamfer_pct"] is None
    assert out["why"] == {"chamfer_pct": "no truth", "odd": "not a finite number"}
    assert out["psnr_srgb"] == 30
