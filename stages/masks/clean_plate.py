"""Masks by difference to a photograph of the empty scene (clean plate)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.capture.pixels.linear import read_linear
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.geometry.lens import lenses
from stages.masks.background import tidy
from stages.masks.inputs import frame_s0

SEED, GROW = 8.0, 3.0
"""Noise standard deviations: a difference is the object's for sure, and may be where it touches such a place."""
RELATIVE = 0.03
"""Of the plate: lamps flicker and a tripod moves by less than that."""
DARKEST_SHADOW = 0.5
"""The object's shadow keeps at least this much of the background's light, in the background's own colour."""


def by_clean_plate(stage: StageRun, views: list[str]) -> dict[str, NDArray[np.bool_]]:
    """Masks [H, W] of the views that have a plate. Raises UserError for a view without one."""
    capture, plates, bent = stage.capture, {}, lenses(stage.inputs)
    out = {}
    for view in views:
        path = capture.clean_plates.get(view)
        if path is None:
            raise UserError(
                capture.root, f"view {view} has no clean plate", "name it like the view or its camera in clean_plate/"
            )
        image = frame_s0(stage, view)
        if path not in plates:
            plates[path] = read_linear(path, capture.config.radiometry).rgb(path)
        have, want = plates[path].shape, (*bent[view].taken, 3) if view in bent else image.shape
        if have != want:
            raise UserError(
                path, f"is {have[1]}x{have[0]}, the view {view} {want[1]}x{want[0]}", "photograph it with the same camera"
            )
        plate = bent[view].image(plates[path]) if view in bent else plates[path]
        out[view] = difference_mask(image, plate)
    return out


def difference_mask(image: NDArray[np.float32], plate: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Where `image` [H, W, 3] shows something that `plate` does not, both linear; the plate's exposure is fitted."""
    lit = plate.mean(-1) > np.percentile(plate.mean(-1), 20)
    gain = np.median(image[lit] / np.maximum(plate[lit], 1e-12), axis=0) if lit.any() else np.ones(3)
    expected = (plate * gain).astype(np.float32)
    difference = image - expected
    quiet = np.median(np.abs(difference - np.median(difference, axis=(0, 1))), axis=(0, 1)) / 0.6745
    spread = np.sqrt(quiet**2 + (RELATIVE * expected) ** 2) + 1e-12
    score = np.sqrt(np.mean((cv2.GaussianBlur(difference, (0, 0), 0.7) / spread) ** 2, axis=-1))
    score[_shadow(image, expected, spread)] = 0
    return tidy(hysteresis(score, GROW, SEED))


def _shadow(image: NDArray, expected: NDArray, spread: NDArray) -> NDArray[np.bool_]:
    """Where the image is the background darkened, in its own colour."""
    factor = (image * expected).sum(-1) / np.maximum((expected * expected).sum(-1), 1e-12)
    rest = np.sqrt(np.mean(((image - factor[..., None] * expected) / spread) ** 2, axis=-1))
    # Grey on grey tells no shadow from an object: only a coloured background can vouch.
    coloured = np.ptp(expected, axis=-1) > 0.1 * expected.max(-1)
    return (factor > DARKEST_SHADOW) & (factor < 1) & (rest < 1.5) & coloured


def hysteresis(score: NDArray, low: float, high: float) -> NDArray[np.bool_]:
    """Parts above `low` that hold something above `high`."""
    _, labels = cv2.connectedComponents((score > low).astype(np.uint8), connectivity=8)
    kept = np.zeros(int(labels.max()) + 1, bool)
    kept[np.unique(labels[score > high])] = True
    kept[0] = False
    return kept[labels]
