"""Do two cameras' poses belong to one world? Their masks tell: one object has one hull."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from stages.masks.hull_check import FLAG, Agreement, check_masks_agree

FEWEST = 4
"""Views of a camera whose hull says something."""
SAMPLE = 12
"""Views of each camera that are held against each other."""


def other_world(masks: list[NDArray[np.bool_]], cameras: list[Camera]) -> tuple[str, str] | None:
    """The names of two physical cameras whose masks [h, w] agree each among themselves, but most of which have no common hull
    with the other's; None where there are none."""
    groups: dict[str, list[int]] = {}
    for k, camera in enumerate(cameras):
        groups.setdefault(camera.name, []).append(k)
    large = {name: _some(members) for name, members in groups.items() if len(members) >= FEWEST}
    if len(large) < 2:
        return None
    apart = {name: _agree(masks, cameras, chosen) for name, chosen in large.items()}
    # masks that do not agree among themselves say nothing of another camera
    sound = [name for name, a in apart.items() if a is not None and np.mean([view.suspicious for view in a]) <= 0.5]
    for first, second in combinations(sorted(sound), 2):
        together = _agree(masks, cameras, large[first] + large[second])
        if together is None:
            return first, second
        apart_by = [max(view.excess, view.blame) for view in together]
        count = len(large[first])
        if min(np.median(apart_by[:count]), np.median(apart_by[count:])) > FLAG:
            return first, second
    return None


def _some(members: list[int]) -> list[int]:
    return [members[k] for k in np.unique(np.linspace(0, len(members) - 1, min(len(members), SAMPLE)).round().astype(int))]


def _agree(masks: list[NDArray[np.bool_]], cameras: list[Camera], chosen: list[int]) -> list[Agreement] | None:
    return check_masks_agree([masks[k] for k in chosen], [cameras[k] for k in chosen])
