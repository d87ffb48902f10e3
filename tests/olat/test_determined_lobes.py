"""Lobes that the lights do not tell are flagged, never called good; a round GGX surface stays round."""

import numpy as np
import pytest

from pipeline.rig.light_table import LightTable
from pipeline.rig.lobe_names import LOBES
from pipeline.rig.map_flags import AWAY, GOOD, OUTSIDE, TOO_FEW
from stages.olat.pixel_fit.lobe_choice import CANDIDATES, choose
from stages.olat.pixel_fit.result_layout import FLAG, map_slices
from synth.olat_pixels import angle_deg, make, rig_of, unit

pytestmark = pytest.mark.slow  # the kernels' first compilation takes most of a minute

AT = map_slices()
COUNT = 400


def rig(directions) -> LightTable:
    d = unit(np.asarray(directions, float))
    return LightTable(d, 100 * d, np.ones(len(d)), np.full(len(d), 4 * np.pi / len(d)))


def cone(count: int, degrees: float, axis=(0.2, 0.1, 1.0)) -> LightTable:
    """Lights spread evenly over a cone of this half-angle."""
    k = np.arange(count) + 0.5
    z = 1 - (1 - np.cos(np.radians(degrees))) * k / count
    a, r = k * np.pi * (3 - 5**0.5), np.sqrt(1 - z * z)
    w = unit(np.array(axis))
    t = unit(np.cross(w, [0, 1, 0]))
    return rig(np.stack([r * np.cos(a), r * np.sin(a), z], -1) @ np.stack([t, np.cross(w, t), w]))


FULL = rig_of()
HALF = rig(FULL.directions[FULL.directions[:, 0] > 0])
SETTINGS = {
    "half a dome": {"rig": HALF, "sigma": (0.4, 0.4)},
    "half a dome, noise": {"rig": HALF, "sigma": (0.4, 0.4), "noise": 0.01},
    "25 degrees": {"rig": cone(30, 25), "sigma": (0.4, 0.4)},
    "25 degrees, noise": {"rig": cone(30, 25), "sigma": (0.4, 0.4), "noise": 0.01},
    "25 degrees aside, noise": {"rig": cone(30, 25, (1, 0.1, 0.6)), "sigma": (0.4, 0.4), "noise": 0.002},
    "3 degrees": {"rig": cone(346, 3), "sigma": (0.4, 0.4)},
    "3 degrees, noise": {"rig": cone(346, 3), "sigma": (0.4, 0.4), "noise": 0.002},
    "narrow, noise .001": {"sigma": (0.02, 0.02), "noise": 0.001},
    "narrow, noise .03": {"sigma": (0.02, 0.02), "noise": 0.03},
    "twenty lights, noise": {"rig": rig_of(20), "sigma": (0.4, 0.4), "noise": 0.01},
    "fine, noise": {"sigma": (0.05, 0.05), "noise": 0.03},
    "brushed, noise": {"sigma": (0.3, 0.03), "noise": 0.005},
}


@pytest.fixture
def fitted(run):
    """fitted(lobe, ...) -> pixels of this lobe (`make`'s options), and what the fit made of them."""

    def call(lobe: str = "ward", **more):
        p = make(COUNT, seed=11, lobe=lobe, **more)
        return p, run(p, lobe=LOBES[lobe])

    return call


@pytest.mark.parametrize("name", SETTINGS)
def test_what_is_called_good_is_right_and_no_albedo_runs_away(fitted, name):
    p, rows = fitted(**SETTINGS[name])
    good = rows[:, FLAG] == GOOD
    albedo = rows[:, AT["specular_albedo"]][:, 0]
    wrong = angle_deg(rows[:, AT["normal"]], p.normal) > 5
    wrong |= (np.abs(rows[:, AT["sigma"]] / p.sigma - 1) > 0.5).any(1) | (np.abs(albedo / p.specular - 1) > 0.5)
    assert (wrong & good).mean() < 0.01
    assert albedo[good].max(initial=0.0) < 1.0  # at most 0.6 were put in
    assert albedo.max() < 12.0  # bounds where it is not determined; 2e28 without them


@pytest.mark.parametrize("sigma, noise", [((0.4, 0.4), 0.0), ((0.2, 0.2), 0.03), ((0.1, 0.1), 0.01), ((0.5, 0.05), 0.005)])
def test_lobes_that_are_determined_stay_good(fitted, sigma, noise):
    _, rows = fitted(sigma=sigma, noise=noise)
    assert np.mean(rows[:, FLAG] == GOOD) > 0.98


def test_peaks_beyond_the_lights_are_flagged_as_that(fitted):
    _, rows = fitted(rig=HALF, sigma=(0.4, 0.4))
    flags = np.bincount(rows[:, FLAG].astype(int), minlength=8)
    assert flags[OUTSIDE] > 0.1 * COUNT and flags[OUTSIDE] + flags[TOO_FEW] + flags[GOOD] == COUNT


@pytest.mark.parametrize("alpha", [0.1, 0.2, 0.4])
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_a_round_ggx_surface_stays_round(fitted, alpha, noise):
    _, rows = fitted("ggx", sigma=(alpha, alpha), noise=noise)
    good = rows[:, FLAG] == GOOD
    assert good.mean() > 0.97
    assert np.mean(rows[good][:, AT["anisotropy"]] > 0.2) < 0.01  # 0.5 under the other lobes
    assert np.median(np.abs(rows[good][:, AT["sigma"]] / alpha - 1)) < (0.01 if noise else 1e-3)


def test_ggx_fits_its_own_pixels_better_than_the_other_lobes(run):
    p = make(COUNT, seed=5, lobe="ggx", sigma=(0.2, 0.2), noise=0.002)
    residual = [run(p, lobe=LOBES[name])[:, AT["residual"]][:, 0] for name in ("ward", "beckmann", "ggx")]
    best = np.argmin(residual, 0)
    assert np.mean(best == 2) > 0.9


def test_normals_that_face_away_are_flagged(run):
    p = make(COUNT, seed=3, sigma=(0.3, 0.3))
    p.rig = LightTable(-p.rig.directions, -p.rig.positions, p.rig.intensity, p.rig.solid_angle)
    rows = run(p)
    assert np.mean(rows[:, FLAG] == AWAY) > 0.95


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.03])
def test_the_flank_of_a_narrow_ggx_lobe_is_not_called_a_gaussian(run, noise):
    p = make(COUNT, seed=11, lobe="ggx", sigma=(0.02, 0.02), noise=noise)
    rows = run(p)  # as a Ward lobe: it has the width of the lights' spacing, and a twentieth of the albedo
    wrong = np.abs(rows[:, AT["specular_albedo"]][:, 0] / p.specular - 1) > 0.5
    assert np.mean(wrong & (rows[:, FLAG] == GOOD)) < 0.01


@pytest.mark.parametrize("lobe", ["ward", "ggx"])
def test_noise_does_not_mix_the_tangents_of_a_wide_round_lobe(fitted, lobe):
    p, rows = fitted(lobe, sigma=(0.8, 0.8), noise=0.01)
    good = rows[:, FLAG] == GOOD
    assert good.mean() > 0.9
    assert np.mean(rows[good][:, AT["anisotropy"]] > 0.1) < 0.01
    assert np.mean(np.abs(rows[good][:, AT["sigma"]] / p.sigma[good] - 1) > 0.5) < 0.01


def test_a_lobe_is_chosen_by_pixels_that_other_forms_do_not_tell(run):
    p = make(100, seed=3, lobe="beckmann", sigma=(1.0, 1.0))
    found = {name: run(p, lobe=LOBES[name]) for name in CANDIDATES}
    assert np.mean(found["ward"][:, FLAG] == GOOD) < 0.5  # wider than the hemisphere, as a Ward lobe
    choice = choose(found)
    assert choice.lobe == "beckmann" and choice.pixels > 50
