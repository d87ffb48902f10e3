"""Unknown polariser angles: the closed form finds them, says how well, and says when nothing can."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from pipeline.capture.model import PolariserPrior
from stages.train.views.angle_fit import JACKKNIFE_INFLATION, AngleSums, fit_angle, fit_views
from stages.train.views.polarisers import PolariserBank


def stokes_field(count: int = 4000) -> torch.Tensor:
    g = torch.Generator().manual_seed(3)
    s0 = 0.2 + torch.rand(count, 3, generator=g)
    phase = 2 * math.pi * torch.rand(count, 1, generator=g)
    dolp = 0.3 * torch.rand(count, 1, generator=g)
    return torch.stack([s0, s0 * dolp * torch.cos(phase), s0 * dolp * torch.sin(phase)], 1)


@pytest.mark.parametrize("degrees", [0.0, 23.0, 90.0, 110.0, 179.0])
def test_closed_form_finds_the_angle_and_its_precision(degrees):
    bank = PolariserBank({"a": PolariserPrior()}, ["a"])
    bank.set_angle("a", math.radians(degrees))
    stokes = stokes_field()
    noise = 0.02 * torch.randn(len(stokes), 3, generator=torch.Generator().manual_seed(1))
    sums = AngleSums.empty()
    sums.add(stokes, bank.intensity(stokes, "a").detach() + noise, torch.ones(len(stokes), 1))
    fit = fit_angle(sums, 1.0)
    error = abs((math.degrees(fit.angle) - degrees + 90) % 180 - 90)
    assert error < 4 * math.degrees(fit.std) and math.degrees(fit.std) < 1.0


def test_unpolarised_data_give_no_precision():
    stokes = stokes_field()
    stokes[:, 1:] *= 1e-6
    sums = AngleSums.empty()
    sums.add(stokes, stokes[:, 0] + 0.01 * torch.randn(len(stokes), 3), torch.ones(len(stokes), 1))
    assert math.degrees(fit_angle(sums, 1.0).std) > 30


def turned_views(off_degrees) -> list[AngleSums]:
    """One view for each offset: what it measures is behind a polariser at 23 degrees, its model turned by the offset."""
    bank = PolariserBank({"a": PolariserPrior()}, ["a"])
    out = []
    for off in off_degrees:
        bank.set_angle("a", math.radians(23.0))
        stokes = stokes_field()
        measured = bank.intensity(stokes, "a").detach()
        turn = torch.tensor(math.radians(2 * off))
        s1, s2 = stokes[:, 1].clone(), stokes[:, 2].clone()
        stokes[:, 1], stokes[:, 2] = torch.cos(turn) * s1 - torch.sin(turn) * s2, torch.sin(turn) * s1 + torch.cos(turn) * s2
        sums = AngleSums.empty()
        sums.add(stokes, measured + 0.02 * torch.randn_like(measured), torch.ones(len(stokes), 1))
        out.append(sums)
    return out


def test_views_that_disagree_say_how_uncertain_an_angle_is():
    off = 3.0 * np.random.default_rng(0).standard_normal(16)
    fit = fit_views(turned_views(off), 1.0)
    expected = JACKKNIFE_INFLATION * off.std(ddof=1) / math.sqrt(len(off))
    assert math.degrees(fit.std) == pytest.approx(expected, rel=0.15)
    assert math.degrees(fit.angle) == pytest.approx(23.0 + off.mean(), abs=0.3)
    assert math.degrees(fit_angle(turned_views([3.0])[0], 1.0).std) < 0.5  # pixels alone would claim that
    assert math.degrees(fit_views(turned_views([3.0]), 1.0).std) > 45  # one view cannot tell


def test_an_unknown_angle_counts_for_nothing_until_it_is_estimated():
    bank = PolariserBank({"a": PolariserPrior(), "b": PolariserPrior(30.0, True)}, ["b", "a"])
    stokes = stokes_field(10)
    assert torch.equal(bank.intensity(stokes, "a"), stokes[:, 0])
    expected = stokes[:, 0] + 0.5 * stokes[:, 1] + math.sqrt(3) / 2 * stokes[:, 2]
    assert torch.allclose(bank.intensity(stokes, "b"), expected, atol=1e-6)
    bank.set_angle("b", 1.0)
    assert bank.result()["b"].angle_deg == pytest.approx(30.0, abs=1e-4)


def test_finite_extinction_lowers_the_contrast():
    bank = PolariserBank({"a": PolariserPrior(0.0, True, extinction=3.0)}, ["a"])
    stokes = stokes_field(10)
    assert torch.allclose(bank.intensity(stokes, "a"), stokes[:, 0] + 0.5 * stokes[:, 1])


CASES = [((20.0,), True), ((20.0, 200.5), True), ((179.5, 0.5), True), ((20.0, 95.0), False)]


@pytest.mark.parametrize(("angles", "bad"), CASES)
def test_says_when_the_angles_determine_nothing(angles, bad):
    names = [f"c{k}" for k in range(len(angles))]
    bank = PolariserBank({n: PolariserPrior(a, True) for n, a in zip(names, angles)}, names)
    assert (bank.undetermined() is not None) == bad
    assert all(0 <= s.angle_deg < 180 for s in bank.result().values())
    assert np.isfinite([s.contrast for s in bank.result().values()]).all()


def test_the_mixture_of_stokes_components_is_what_the_intensity_uses():
    bank = PolariserBank({"a": PolariserPrior(37.0, True, extinction=5.0), "b": PolariserPrior()}, ["a", "b"])
    stokes = stokes_field(50)
    for name in bank.names:
        m1, m2 = bank.mix(name)
        mixed = stokes[:, 0] + m1 * stokes[:, 1] + m2 * stokes[:, 2]
        assert torch.allclose(mixed, bank.intensity(stokes, name), atol=1e-6)
