"""Exposure brackets: a black level that nobody told, and times that are not those of the pictures, are said; noise is not."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.capture.pixels.bracket_levels import bracket_doubt
from synth.ball import ring, save, transforms
from tests.capture.little_captures import codes, stokes, write

TIMES = (0.25, 1.0, 4.0)


def bracket(level=0.0, noise=0.002, times=TIMES, side=64):
    rng = np.random.default_rng(2)
    light = stokes(0, side=side)[:, :, 0] * 0.5
    images = [np.clip(np.round((light * t + level + rng.normal(0, noise, light.shape)) * 4095) / 4095, 0, 1) for t in times]
    images = [image.astype(np.float32) for image in images]
    return images, [(image >= 1).any(-1) for image in images]


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.01])
def test_a_sound_bracket_gets_no_word(noise):
    assert bracket_doubt(*bracket(noise=noise), TIMES) is None


@pytest.mark.parametrize(("level", "words"), [(0.016, "more"), (-0.02, "less")])
def test_a_black_level_is_measured(level, words):
    found = bracket_doubt(*bracket(level), TIMES)
    assert found is not None and f"of the white level {words} than" in found
    assert abs(float(found.split("holds ")[1].split()[0]) - abs(level)) < 0.002


def test_times_that_are_not_those_of_the_pictures_are_said_and_rounded_shutters_are_not():
    found = bracket_doubt(*bracket(), (0.25, 1.0, 2.0))
    assert found is not None and "ratio 2" in found and "factor of 4" in found
    assert bracket_doubt(*bracket(times=(1 / 64, 1 / 16, 1 / 4)), (1 / 60, 1 / 15, 1 / 4)) is None


def test_an_even_or_clipped_picture_tells_nothing():
    even = [np.full((64, 64, 3), 0.1 * t + 0.02, np.float32) for t in (1, 2)]
    assert bracket_doubt(even, [np.zeros((64, 64), bool)] * 2, (1, 2)) is None
    images, _ = bracket(0.02)
    assert bracket_doubt(images, [np.ones((64, 64), bool)] * 3, TIMES) is None


@pytest.mark.parametrize("level", [0.0, 0.016])
def test_decode_tells_of_it(tmp_path, level):
    for k in range(3):
        for stops, image in zip((-2, 0, 2), bracket(level)[0]):
            write(tmp_path / "images" / f"{k}_ev{stops:+d}.png", codes(np.roll(image, k, 1)))
    save(tmp_path / "transforms.json", transforms(ring(3, 64), [f"images/{k}" for k in range(3)]))
    faults = [fault for view in open_capture(tmp_path).views for fault in view.read().faults]
    assert [("check radiometry.black_level" in fault) for fault in faults] == [True] * (3 if level else 0)
