"""Pictures that are much saturated, or fainter than single precision squares, are warned of; others are not."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stages.calib.decode.light_doubts import FrameRecord, doubt_light
from stages.metrics.image_figures import displayable


@pytest.mark.parametrize(
    ("share", "peak", "words"),
    [
        (0.002, 3.0, []),
        (0.049, 1e15, []),
        (0.07, 1.0, ["7 % of all samples are saturated"]),
        (0.0, 1e-31, ["is 1e-31"]),
        (0.0, 0.0, []),
    ],
)
def test_doubtful_levels_are_warned_of(share, peak, words):
    said: list[str] = []
    records = [FrameRecord({"saturated_fraction": share}, {}, pixels=100, peak=peak)] * 2
    stage = SimpleNamespace(capture=SimpleNamespace(root=Path("capture")), warn=said.append)
    doubt_light(stage, records)
    assert len(said) == len(words) and all(word in line for word, line in zip(words, said))


@pytest.mark.parametrize(
    ("bright", "words"),
    [
        ([1, 2, 0.5, 1, 4, 1, 0.2, 1], []),
        ([1, 1, 1, 255, 1, 1, 1, 1], ["not as bright as the other views: 3 (255 times)"]),
        ([1, 1, 1, 1, 1, 1, 1 / 16, 1], ["6 (0.0625 times)"]),
        ([1, 1, 1, 0, 1, 1], []),  # nothing but black is told elsewhere
        ([1, 1, 100], []),
        ([1, 100, 1, 100, 1, 100], []),
    ],
)
def test_views_on_a_scale_of_their_own_are_warned_of(bright, words):
    said: list[str] = []
    records = [
        FrameRecord({"saturated_fraction": 0.0, "file": f"frames/{k}.exr"}, {}, pixels=100, peak=1.0, bright=b)
        for k, b in enumerate(bright)
    ]
    doubt_light(SimpleNamespace(capture=SimpleNamespace(root=Path("capture")), warn=said.append), records)
    assert len(said) == len(words) and all(word in line for word, line in zip(words, said))


def test_figures_of_display_values_are_of_radiance_that_a_display_shows():
    radiance = np.random.default_rng(0).uniform(0.01, 3.0, (50, 3))
    assert displayable(radiance) and displayable(np.append(np.full(95, 30.0), np.full(5, 0.5)))
    assert not displayable(1e30 * radiance) and not displayable(1e-30 * radiance)
