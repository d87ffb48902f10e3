"""The maps that come with the program: as computed, equally bright, and what a call without a map is relit under."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.capture import Capture
from pipeline.engine.settings import Settings, remembered_settings, with_environments
from pipeline.environments import DEFAULT, SHIPPED, shipped_map
from pipeline.errors import UserError
from pipeline.formats.images import RGB, read_image, write_rgb
from synth.environments import meadow
from synth.shipped_maps import brightest_matte, computed


@pytest.fixture
def capture(tmp_path):
    return Capture(tmp_path, "made up", "multiview", "none")


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_map_is_the_computed_one_and_as_bright_as_the_others(name):
    stored = read_image(shipped_map(name), RGB)
    assert np.allclose(stored, computed(name), rtol=1e-3, atol=1e-4)  # halves
    assert brightest_matte(stored) == pytest.approx(1, abs=0.002)
    if name == "neutral_studio":
        assert (stored == stored[..., :1]).all()


def test_where_no_map_is_given_the_default_ones_are_used_and_otherwise_exactly_what_is_given(capture, tmp_path):
    def names(*given: str, own: tuple[Path, ...] = ()) -> list[str]:
        scene = Capture(tmp_path, "made up", "multiview", "none", environments=own)
        return [p.stem for p in with_environments(scene, tuple(map(Path, given))).environments]

    write_rgb(tmp_path / "own.hdr", meadow(8))
    own = (tmp_path / "own.hdr",)
    assert names() == list(DEFAULT)
    assert names("none") == []
    assert names("overcast_sky") == ["overcast_sky"]
    assert names(own=own) == ["own"]
    assert names("none", own=own) == ["own"]
    assert names("neutral_studio", own=own) == ["own", "neutral_studio"]


@pytest.mark.parametrize(
    ("given", "said"),
    [("neutral_studo", "did you mean neutral_studio"), ("none clear_sky", "leave out none"), ("no.hdr", "check ENVS=")],
)
def test_a_map_that_there_is_not_is_refused_with_the_nearest_name(capture, given, said):
    with pytest.raises(UserError, match=said):
        with_environments(capture, tuple(map(Path, given.split())))


def test_names_of_maps_are_remembered_as_names_wherever_the_program_lies(tmp_path):
    given = Settings({}, (Path("neutral_studio"), tmp_path / "a.hdr", Path("none")))
    kept = given.as_json(tmp_path / "d")
    assert kept["environments"] == ["neutral_studio", "../a.hdr", "none"]
    assert remembered_settings({"given": kept}, tmp_path / "d", {}).environments == given.environments
