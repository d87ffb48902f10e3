"""Rules about a capture's views that several stages keep."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipeline.capture.model import Capture

MIN_TRAINING_VIEWS = 8
"""Fewer views around an object determine no model of it."""
TEST_EVERY = 8
"""Every how many-th view, in sorted order and from the first, is held back to test the model (as in Mip-NeRF 360)."""


def too_few_views(capture: Capture) -> str | None:
    """Why a multi-view capture has no model, None where it has views enough."""
    count = len(capture.views)
    if count >= MIN_TRAINING_VIEWS:
        return None
    return f"too few views for a model: {count}, at least {MIN_TRAINING_VIEWS} are needed"


def held_back(names: Iterable[str]) -> frozenset[str]:
    """Which of the views are held back from training."""
    return frozenset(sorted(names)[::TEST_EVERY])
