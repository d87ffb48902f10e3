"""The standard deviations that the fits state are those that noise makes, and one pass alone is taken apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.rig.lobe_names import LOBES
from pipeline.rig.map_flags import GOOD, NO_LOBE
from stages.olat.pixel_fit.fit_options import PASSES
from stages.olat.pixel_fit.result_layout import FLAG, map_slices
from synth.olat_pixels import Pixels, angle_deg, make

pytestmark = pytest.mark.slow
AT = map_slices()


def errors(rows: np.ndarray, pixels: Pixels) -> dict[str, np.ndarray]:
    """Error of each map that has a standard deviation [P]."""

    def of(name: str) -> np.ndarray:
        return rows[:, AT[name]]

    normals = {name: angle_deg(of(name), pixels.normal) for name in ("diffuse_normal", "specular_normal", "normal")}
    return {
        **normals,
        "diffuse_albedo": np.sqrt(((of("diffuse_albedo") - pixels.albedo) ** 2).mean(1)),
        "specular_albedo": np.abs(of("specular_albedo")[:, 0] - pixels.specular),
        "sigma": np.sqrt(((of("sigma") - pixels.sigma) ** 2).mean(1)),
    }  # fmt: skip


@pytest.mark.parametrize("lobe", ["ward", "beckmann"])
@pytest.mark.parametrize("noise", [2e-3, 1e-2])
def test_stated_deviations_are_right_within_one_and_a_half(run, lobe, noise):
    pixels = make(300, lobe=lobe, noise=noise, seed=1, sigma=(0.3, 0.3))
    rows = run(pixels, lobe=LOBES[lobe])
    good = rows[:, FLAG] == GOOD
    assert good.mean() > 0.9
    for name, error in errors(rows, pixels).items():
        stated = rows[good, AT[f"std_{name}"]].ravel()
        ordinary = error[good] < np.quantile(error[good], 0.99)  # one fit in a hundred may end elsewhere
        ratio = np.sqrt(np.mean(stated[ordinary] ** 2) / np.mean(error[good][ordinary] ** 2))
        assert 1 / 1.5 < ratio < 1.5, name


def test_a_lobe_that_is_not_determined_says_so(run):
    """Narrower than the lights are apart: whatever is stated for its width is as uncertain as it is large."""
    pixels = make(100, sigma=(0.03, 0.03), noise=2e-3, seed=3)
    rows = run(pixels)
    unsure = (rows[:, FLAG] != GOOD) & (rows[:, AT["sigma"]][:, 0] > 0)
    assert unsure.sum() > 50
    assert np.all(rows[unsure, AT["std_sigma"]].ravel() >= 0.99 * rows[unsure, AT["sigma"]].min(1))
    assert np.isfinite(rows).all()


@pytest.mark.parametrize("passes", ["parallel", "none"])
def test_one_pass_is_told_apart_by_the_fit(run, passes):
    """Highlights and cast shadows in the only frames that there are: normals of 0.2 degrees, the lobe as with two passes."""
    pixels = make(200, lobe="beckmann", sigma=(0.15, 0.15), noise=5e-3, seed=2, shadow=0.5)
    frames = pixels.parallel if passes == "parallel" else 2 * pixels.parallel
    rows = run(replace(pixels, cross=frames, parallel=frames), lobe=LOBES["beckmann"], one_pass=PASSES[passes])
    error = errors(rows, pixels)
    assert np.median(error["diffuse_normal"]) < 0.4 and error["diffuse_normal"].mean() < 0.6
    assert np.median(error["diffuse_albedo"] / pixels.albedo.mean(1)) < 0.02
    good = rows[:, FLAG] == GOOD
    assert good.mean() > 0.8
    assert np.median(rows[good][:, AT["sigma"]]) == pytest.approx(0.15, rel=0.03)
    assert np.median(rows[good][:, AT["specular_albedo"]][:, 0] / pixels.specular[good]) == pytest.approx(1, abs=0.05)


def test_crossed_polarisers_alone_give_the_diffuse_part_and_no_lobe(run):
    pixels = make(100, noise=2e-3, seed=4)
    both = run(pixels)
    rows = run(replace(pixels, parallel=pixels.cross), one_pass=PASSES["cross"])
    np.testing.assert_allclose(rows[:, AT["diffuse_normal"]], both[:, AT["diffuse_normal"]], atol=1e-6)
    np.testing.assert_allclose(rows[:, AT["diffuse_albedo"]], both[:, AT["diffuse_albedo"]], atol=1e-6)
    assert np.all(rows[:, FLAG] == NO_LOBE) and not rows[:, AT["specular_albedo"]].any()
