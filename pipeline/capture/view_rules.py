"""Rules about a capture's views that several stages keep."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from pipeline.capture.model import Capture

MIN_TRAINING_VIEWS = 8
"""Fewer views around an object determine no model of it."""
TEST_EVERY = 8
"""Every how many-th view, in sorted order and from the first, tests the model, unless the capture's own tables say."""
FEWEST_CAMERAS = 3
"""Of a light stage, for a surface: two silhouettes bound no object, and two normal maps have no majority."""
HeldBack = Literal["validation", "test"]


def too_few_views(capture: Capture) -> str | None:
    """Say why a multi-view capture has no model.

    Args:
        capture: as recognised.

    Returns:
        The reason; None where it has `MIN_TRAINING_VIEWS` or more.
    """
    count = len(capture.views)
    if count >= MIN_TRAINING_VIEWS:
        return None
    return f"too few views for a model: {count}, at least {MIN_TRAINING_VIEWS} are needed"


def held_back(names: Iterable[str], parts: Mapping[str, str] | None = None) -> dict[str, HeldBack]:
    """Choose the views that take no part in training.

    Args:
        names: VIEWs.
        parts: "train", "validation" or "test" by VIEW, where the capture's own tables say; None: by `TEST_EVERY`.

    Returns:
        Held-back VIEW to what for.
    """
    if not parts:
        return dict.fromkeys(sorted(names)[::TEST_EVERY], "test")
    known: dict[str, HeldBack] = {"validation": "validation", "test": "test"}
    return {name: known[parts[name]] for name in names if parts.get(name) in known}
