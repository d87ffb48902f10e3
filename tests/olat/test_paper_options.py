"""PRF's Algorithm 1 with its two numbers, Ma et al. 2007 with a width that can be rendered, and what solvers refuse."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.rig.light_table import LightTable
from stages.olat.maps.map_files import MapWriter
from stages.olat.parameters import OlatParameters
from stages.olat.pixel_fit.result_layout import MAPS, map_slices
from stages.olat.zoo.paper_chain import cosines, lights_of, moment, reached, separated
from synth.olat_pixels import make, unit

AT = map_slices()


def test_algorithm_1_says_how_much_light_it_took_away(run_halves):
    p = make(60, sigma=(0.12, 0.12), seed=4)
    p.parallel[p.parallel > 1.0] *= 3.0  # spikes
    kept = run_halves(p, saturation=1.0, remove=True)[:, AT["removed"]]
    lit = (p.parallel >= 1.0).any((0, 2))
    assert np.all(kept[~lit] == 0) and np.all(kept[:, 0] == 0) and 0.05 < kept[lit, 1].max() < 1
    assert np.all(run_halves(p, saturation=1.0, remove=True, gap=0.99)[:, AT["removed"]] == 0)  # no gap is that wide
    again = run_halves(p, saturation=1.0, remove=True, removals=4)[:, AT["removed"]]
    p.parallel = np.minimum(p.parallel, 1.0)  # clipped all at one level: what a second round takes is below it
    once, twice = (run_halves(p, saturation=0.99, remove=True, removals=m)[:, AT["removed"]] for m in (1, 2))
    assert np.all(twice >= once - 1e-6) and twice.sum() > 1.01 * once.sum() > 0
    assert np.all(again >= kept - 1e-6) and again.sum() > kept.sum()
    assert np.all(run_halves(p)[:, AT["removed"]] == 0)


def test_ma_et_al_leave_a_lobe_that_can_be_rendered(run_halves):
    p = make(100, sigma=(0.3, 0.3), seed=9)
    rows = run_halves(p, gradient=True)
    assert np.median(np.abs(rows[:, AT["sigma"]] / 0.3 - 1)) < 0.2
    assert np.median(np.abs(rows[:, AT["specular_albedo"]][:, 0] / p.specular - 1)) < 0.3
    assert np.allclose(rows[:, AT["roughness"]][:, 0] ** 2, rows[:, AT["sigma"]][:, 0])


@pytest.mark.parametrize(
    "options, what",
    [
        ({"solver": "gauss-newton", "lobe": "ggx"}, "Ward"),
        ({"solver": "gradient", "lobe": "beckmann"}, "Ward"),
        ({"solver": "lbfgs-zoom", "precision": "float64"}, "float32"),
        ({"overexposure_gap": 0.0}, "overexposure_gap"),
        ({"overexposure_rounds": 0}, "overexposure_rounds"),
    ],
)
def test_what_an_option_cannot_do_is_refused_by_name(options, what):
    with pytest.raises(ValueError, match=what):
        OlatParameters(**options)


def test_the_solvers_lights_are_the_kernels_near_and_coloured(settings):
    rig = make(1).rig
    near = LightTable(rig.directions, 2.0 * rig.directions, rig.intensity, rig.solid_angle)
    point = np.array([[0.3, -0.2, 0.1]])
    w, energy = lights_of(near, point, np.pi)
    away = near.positions - point
    np.testing.assert_allclose(w[0], unit(away), atol=1e-6)
    np.testing.assert_allclose(energy[0], np.pi * 4.0 / np.sum(away * away, 1), rtol=1e-5)
    n = unit(np.array([[0.1, 0.2, 1.0]]))
    samples = np.maximum(cosines(n, w), 0)
    assert np.allclose(unit(moment(samples, w)), unit(samples @ w[0]))
    frames = np.repeat((samples * energy / (2 * np.pi)).T[..., None], 3, -1)
    rgb, shine, fine = separated(frames, frames, near, energy, settings)
    np.testing.assert_allclose(rgb.mean(-1), samples, atol=1e-5)
    assert fine.all() and np.all(shine == 0)
    shadowed = samples * (np.arange(samples.shape[1]) % 5 > 0)
    lit = reached(shadowed, cosines(n, w))
    assert not lit[(samples > 0.1) & (shadowed == 0)].any() and lit[shadowed > 0].all()


def test_a_map_that_no_option_asked_for_is_not_written(tmp_path):
    with MapWriter(tmp_path / "a", 4, 4) as plain, MapWriter(tmp_path / "b", 4, 4, ("removed",)) as asked:
        assert "removed" not in plain.files and set(asked.files) == set(MAPS)
    assert not (tmp_path / "a" / "removed.exr").exists() and (tmp_path / "b" / "removed.exr").exists()
