"""What physics allows to be checked of a Stokes capture: the sense of the angle, its zero, the signs.

A dielectric seen near its silhouette polarises diffuse light along the image projection of the normal, that is across
the outline; mirrored light along the outline. Which of the eight frames (four turns by 45°, mirrored or not) makes the
polarised part of a capture most consistent tells a swapped order or a flipped sign, where the images have the signal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.capture import Capture

SAMPLE_PIXELS = 4096


def sample_stokes(stokes: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
    """A coarse grid of one view's grey Stokes vectors with their places, for checks over all views."""
    height, width = stokes.shape[:2]
    step = max(1, int(np.sqrt(height * width / SAMPLE_PIXELS)))
    grey = stokes[step // 2 :: step, step // 2 :: step].mean(-1)
    return {"stokes": grey, "step": np.float32(step).reshape(1)}


def check_stokes(capture: Capture, samples: dict[str, dict[str, NDArray[np.float32]]]) -> list[str]:
    """Lines to tell the user; empty where nothing is suspicious or nothing can be known."""
    return []
