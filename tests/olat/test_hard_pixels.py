"""Pixels with nothing, or too much, to fit: a flag and a stated fallback, never anything that is not finite."""

import numpy as np
import pytest

from pipeline.rig.lobe_names import LOBES
from pipeline.rig.map_flags import BAD_SAMPLES, BLACK, GOOD, NO_LOBE, SATURATED, TOO_FEW
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.pixel_fit.result_layout import FLAG, map_slices
from synth.olat_pixels import angle_deg, make

pytestmark = pytest.mark.slow  # the kernels' first compilation takes most of a minute

AT = map_slices()


def flags(rows: np.ndarray) -> set[int]:
    return set(rows[:, FLAG].astype(int))


def test_black_pixels_are_flagged_and_face_the_camera(run):
    p = make(5)
    p.cross[:], p.parallel[:] = 0, 0
    rows = run(p)
    assert flags(rows) == {BLACK}
    assert np.all(rows[:, AT["diffuse_albedo"]] == 0)
    assert np.allclose(rows[:, AT["normal"]], p.view)


def test_negative_pixels_are_black(run):
    p = make(5)
    p.cross[:], p.parallel[:] = -0.01, -0.02
    assert flags(run(p)) == {BLACK}


@pytest.mark.parametrize("lit", [1, 2, 3])
def test_up_to_three_lit_lights_are_too_few(lit, run):
    p = make(20, sigma=(0.3, 0.3))
    order = np.argsort(-p.cross.mean(-1), axis=0)
    for j in range(20):
        p.cross[order[lit:, j], j] = 0
        p.parallel[order[lit:, j], j] = 0
    rows = run(p)
    assert flags(rows) == {TOO_FEW}
    assert np.all(angle_deg(rows[:, AT["diffuse_normal"]], p.normal) < 60)  # still among the lit lights


def test_every_sample_clipped_is_saturated(run):
    p = make(5)
    p.cross[:], p.parallel[:] = 4.0, 4.0
    assert flags(run(p, saturation=4.0)) == {SATURATED}


def test_nan_and_inf_samples_are_left_out(run):
    p = make(50, sigma=(0.3, 0.3), seed=1)
    clean = run(p)
    p.cross[::40, :, 1] = np.nan
    p.parallel[7::50, :, 0] = np.inf
    rows = run(p)
    assert flags(rows) == {GOOD}
    assert np.median(angle_deg(rows[:, AT["normal"]], clean[:, AT["normal"]])) < 0.01
    p.cross[::3] = np.nan
    assert flags(run(p)) == {BAD_SAMPLES}


def test_a_mirror_between_the_lights_is_flagged_not_fitted(run):
    p = make(100, sigma=(0.01, 0.01), seed=2)
    rows = run(p)
    assert np.mean(rows[:, FLAG] != GOOD) > 0.95
    assert np.median(angle_deg(rows[:, AT["diffuse_normal"]], p.normal)) < 0.01  # the diffuse side is sound


@pytest.mark.parametrize("sigma", [0.01, 0.05])
def test_a_highlight_that_one_light_shows_has_no_larger_albedo_than_the_surface(sigma, run):
    p = make(300, sigma=(sigma, sigma), seed=2)  # the light lies beside the lobe: exp(-tan²/sigma²) there would divide by 1e-30
    albedo = run(p)[:, AT["specular_albedo"]][:, 0]
    assert albedo.max() < 1.5 * p.specular.max()


def test_no_specular_light_is_no_lobe_and_the_diffuse_normal_stands_in(run):
    p = make(20, seed=3)
    p.parallel[:] = p.cross
    rows = run(p)
    assert flags(rows) == {NO_LOBE}
    assert np.all(rows[:, AT["specular_albedo"]] == 0) and np.all(rows[:, AT["sigma"]] == 0)
    assert np.allclose(rows[:, AT["specular_normal"]], rows[:, AT["diffuse_normal"]])


@pytest.mark.parametrize("sigma", [3.0, 5.0, 50.0])
def test_a_lobe_wider_than_the_hemisphere_is_flagged_and_leaves_the_normals(sigma, run):
    p = make(50, sigma=(sigma, sigma), seed=4)
    rows = run(p)
    assert np.mean(rows[:, FLAG] == NO_LOBE) > 0.8
    assert np.all(rows[:, AT["sigma"]] <= 10.0)
    assert np.median(angle_deg(rows[:, AT["normal"]], p.normal)) < 0.1


def test_samples_that_overflow_leave_unit_normals(run):
    p = make(50, seed=4)
    for scale in (1e-30, 1e30):
        p.cross, p.parallel = p.cross * scale, p.parallel * scale
        rows = run(p)
        for name in ("normal", "diffuse_normal", "specular_normal"):
            assert np.allclose(np.linalg.norm(rows[:, AT[name]], axis=1), 1, atol=1e-3)


def test_a_grazing_view_stays_finite_and_right(run):
    p = make(200, sigma=(0.2, 0.2), tilt_deg=86, seed=5)
    rows = run(p)
    steep = np.sum(p.normal * p.view, -1) < 0.25
    assert steep.sum() > 10
    assert np.median(angle_deg(rows[steep][:, AT["diffuse_normal"]], p.normal[steep])) < 0.05


def test_a_black_albedo_under_a_lobe_takes_its_normal_from_the_lobe(run):
    p = make(50, sigma=(0.3, 0.3), seed=6)
    p.parallel -= p.cross
    p.cross[:] = 0
    rows = run(p)
    assert np.median(angle_deg(rows[:, AT["normal"]], p.normal)) < 0.5
    assert np.all(rows[:, AT["diffuse_albedo"]] == 0)


def test_light_exactly_opposite_the_view_is_harmless(run):
    p = make(5, sigma=(0.3, 0.3))
    p.view[:] = -p.rig.directions[10]
    assert np.isfinite(run(p)).all()


@pytest.mark.parametrize("lobe", ["ward", "beckmann", "ggx"])
def test_a_light_exactly_opposite_the_view_has_no_say_where_no_diffuse_normal_is_known(lobe, run):
    p = make(50, sigma=(0.3, 0.3), seed=6, lobe=lobe)
    p.parallel -= p.cross
    p.cross[:] = 0
    p.rig.directions[0] = -p.view[0]
    p.parallel[0] = 0
    rows = run(p, lobe=LOBES[lobe])
    assert rows[0, AT["specular_albedo"]] == pytest.approx(p.specular[0], rel=0.01)  # 1e-14 where the lobe of h = 0 counts
    assert np.abs(rows[0, AT["sigma"]] / 0.3 - 1).max() < 0.01


def test_very_bright_and_very_dim_captures_give_the_same_maps(run, settings):
    p = make(30, sigma=(0.3, 0.2), seed=7)
    base = run(p)
    for scale in (1e-3, 1e3):
        rows, _ = fit((p.cross * scale).astype("f4"), (p.parallel * scale).astype("f4"), p.view, p.rig,
                      settings._replace(irradiance=np.pi * scale))  # fmt: skip
        assert np.allclose(rows[:, AT["sigma"]], base[:, AT["sigma"]], rtol=1e-3)
        assert np.allclose(rows[:, AT["diffuse_albedo"]], base[:, AT["diffuse_albedo"]], rtol=1e-4)
