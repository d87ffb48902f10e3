"""Spherical harmonics of what leaves each Gaussian, by least squares over the cameras that see it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pipeline.formats.images import srgb_encode
from pipeline.splats import harmonics

from .samples import Samples

SMOOTH = 3e-3  # of the squared Laplacian against the samples: what no camera saw is a smooth continuation of what some did
CHUNK = 8192  # Gaussians solved for at a time: 8 MB of normal equations
ROUNDS = 1  # of giving back what blending the discs blurs: 0.9 dB; a second adds nothing
WHITE = 0.995  # quantile of the radiance that is shown as white: highlights of a glossy object are brighter

Array = NDArray[np.float64]


def white_of(samples: Sequence[Samples]) -> float:
    """The radiance that files of 8 bits show as white."""
    brightest = np.concatenate([s.radiance.max(1) for s in samples]) if samples else np.zeros(0)
    return float(np.quantile(brightest, WHITE)) if len(brightest) and brightest.max() > 0 else 1.0


def encoded(radiance: NDArray, white: float) -> NDArray[np.float32]:
    """sRGB in 0..1 of radiance, `white` being 1."""
    return srgb_encode(np.clip(radiance / white, 0, 1)).astype(np.float32)


def fit_colours(
    means: NDArray, samples: Sequence[Samples], white: float, blended: Callable[[Array, Samples], NDArray]
) -> Array:
    """Coefficients [N, 16, 3] of sRGB colours, less 0.5 (`SplatCloud`), in the frame of the means [N, 3].

    Fitted to the samples first; what discs that reach over each other blur away is then added by ROUNDS of fitting to the
    difference. blended(coefficients, samples): the colours [M, 3] that a rendering of these coefficients shows there.
    """
    wanted = [encoded(s.radiance, white) for s in samples]
    out = _solved(means, samples, [colour - 0.5 for colour in wanted])
    for _ in range(ROUNDS):
        out += _solved(means, samples, [colour - blended(out, s) for colour, s in zip(wanted, samples)])
    seen = np.zeros(len(means), bool)
    for s in samples:
        seen[s.rows] = True
    if seen.any() and not seen.all():
        out[~seen] = out[seen][cKDTree(means[seen]).query(means[~seen])[1]]
    return out


def _solved(means: NDArray, samples: Sequence[Samples], values: Sequence[NDArray]) -> Array:
    """Coefficients [N, 16, 3] nearest to values [M, 3] of the samples; 0 where there is none."""
    out = np.zeros((len(means), harmonics.COEFFICIENTS, 3))
    totals = np.zeros(len(means))
    for s in samples:
        totals[s.rows] += s.weight
    usual = float(np.median(totals[totals > 0])) if totals.any() else 0.0
    penalty = SMOOTH * (harmonics.DEGREE * (harmonics.DEGREE + 1.0)) ** 2 / (4 * np.pi)
    for first in range(0, len(means), CHUNK):
        here = means[first : first + CHUNK]
        square = np.zeros((len(here), harmonics.COEFFICIENTS, harmonics.COEFFICIENTS))
        right, total = np.zeros((len(here), harmonics.COEFFICIENTS, 3)), totals[first : first + CHUNK]
        for s, value in zip(samples, values):
            part = slice(*np.searchsorted(s.rows, (first, first + len(here))))
            rows, weight = s.rows[part] - first, s.weight[part].astype(np.float64)
            away = here[rows] - s.centre
            b = harmonics.basis(away / np.linalg.norm(away, axis=1, keepdims=True))
            weighted = weight[:, None] * b
            square[rows] += weighted[:, :, None] * b[:, None]  # a camera names a row once
            right[rows] += weighted[:, :, None] * value[part, None]
        found = total > 0
        square[found] += np.maximum(total[found], usual)[:, None, None] * np.diag(penalty)
        out[first : first + CHUNK][found] = np.linalg.solve(square[found], right[found])
    return out
