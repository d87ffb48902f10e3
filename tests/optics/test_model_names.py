"""The names that options offer are those that the shading knows."""

from __future__ import annotations

import typing

from pipeline.optics import model_names as names
from pipeline.shading.prefilter import LOBES
from stages.relight.stage import RelightParameters
from stages.train.parameters import TrainParameters


def test_every_name_offered_is_known() -> None:
    assert tuple(names.MIRRORS) == typing.get_args(names.Mirror)
    assert tuple(LOBES) == names.DISTRIBUTIONS


def test_training_and_relighting_offer_the_same_mirrors() -> None:
    for parameters in (TrainParameters, RelightParameters):
        assert typing.get_args(typing.get_type_hints(parameters)["mirror"]) == tuple(names.MIRRORS)
