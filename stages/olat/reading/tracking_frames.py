"""Frames under all lights before and after a pass: has the object moved while it was photographed?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture import LightStageCamera
from pipeline.errors import UserError
from pipeline.formats.images import read_image
from stages.olat.reading.misregistration import SIDE
from stages.olat.reading.movement import Movement, movement_between

LIT = 0.25  # of the brightest tracking frame's light: darker ones are dark frames


def movement_during(camera: LightStageCamera, mask: NDArray[np.bool_]) -> Movement | None:
    """Measure how the last frame under all lights lies off the first.

    Args:
        camera: with its frames under all lights.
        mask: the object. [H, W]

    Returns:
        The movement; None where there are none both before and after the lights, or they tell nothing.
    """
    before = [path for path in camera.full_light if _order(path) < _order(camera.cross[0])]
    after = [path for path in camera.full_light if _order(path) > _order(camera.cross[-1])]
    step = max(1, -(-max(mask.shape) // SIDE))
    found = {path: _grey(path, mask.shape) for path in (*before, *after)}
    levels = {path: float(image[mask].mean()) for path, image in found.items() if image is not None}
    lit = [path for path, level in levels.items() if level > LIT * max(levels.values())]
    first, last = (next((p for p in side if p in lit), None) for side in (before, after[::-1]))
    a, b = found.get(first) if first else None, found.get(last) if last else None
    if a is None or b is None:
        return None
    return movement_between(a[::step, ::step], b[::step, ::step], mask[::step, ::step], step)


def _order(path: Path) -> tuple[int, str]:
    return len(path.name), path.name


def _grey(path: Path, shape: tuple[int, ...]) -> NDArray[np.float64] | None:
    """The mean of a frame's channels, if it is a picture of this size: what lies beside the lights' frames may be anything."""
    try:
        image = np.nan_to_num(read_image(path), posinf=0.0, neginf=0.0)[..., :3].mean(-1)
    except UserError:
        return None
    return np.maximum(image, 0).astype(np.float64) if image.shape == shape else None
