"""HDR-FLIP (Andersson et al. 2021): what a person sees of the difference between two linear images, at every exposure.

The measure is its authors' own code (`flip_evaluator`, BSD-3). That takes the exposures from the median of the whole frame,
which is black around an object; here they are the paper's, of the pixels that show something.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WHITE = 0.85  # of the display: what the brightest pixel comes to at the first exposure, and the median at the last
ACES = ((0.36 * 2.51, 0.6 * 0.03, 0.0), (0.36 * 2.43, 0.6 * 0.59, 0.14))
"""The measure's tone mapper, one quadratic over another: Narkowicz' fit of ACES, exposed by 0.6."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def exposures(truth: NDArray, shown: NDArray[np.bool_]) -> tuple[float, float] | None:
    """First and last exposure (stops) for linear RGB [H, W, 3] over the pixels `shown`; None where all of them are black."""
    luminance = np.maximum(truth[shown], 0) @ LUMINANCE
    luminance = luminance[luminance > 0]
    if not len(luminance):
        return None
    above, below = np.array(ACES)
    white = float(np.roots(above - WHITE * below).real.max())
    first, last = np.log2(white / luminance.max()), np.log2(white / np.median(luminance))
    return float(first), float(max(last, first + 1e-3))


def hdr_flip(image: NDArray, truth: NDArray, shown: NDArray[np.bool_]) -> NDArray[np.float32] | None:
    """Error [H, W] in 0..1 of a linear image [H, W, 3], at 67 pixels a degree; None where the truth is black in `shown`."""
    from flip_evaluator import evaluate

    span = exposures(truth, shown)
    if span is None:
        return None
    a, b = (np.ascontiguousarray(np.maximum(np.nan_to_num(x), 0), np.float32) for x in (image, truth))
    chosen = {"startExposure": span[0], "stopExposure": span[1]}
    error, _, _ = evaluate(b, a, "HDR", applyMagma=False, computeMeanError=False, parameters=chosen)
    return np.asarray(error, np.float32)[..., 0]
