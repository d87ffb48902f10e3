"""What the residuals of an angle stack tell: the noise of a sample, and whether something moved between the angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MISFIT = 0.25
"""Of the polarised part: residuals that are smooth and this large come from wrong angles, not from noise."""
OTHER_PICTURES = 0.1
"""Of the light: residuals from which the pictures may be of different things altogether."""
MOVED = 0.25
"""Of the local contrast: residuals this large at edges are a shift of a quarter of a pixel, not noise."""


def residuals(samples: NDArray[np.float32], design: NDArray[np.float64]) -> NDArray[np.float32]:
    """What no Stokes vector explains of samples [n, R, W, C]."""
    projector = (np.eye(len(design)) - design @ np.linalg.pinv(design)).astype(np.float32)
    return (projector @ samples.reshape(len(samples), -1)).reshape(samples.shape)


def unexplained(samples: NDArray[np.float32], design: NDArray[np.float64]) -> float:
    """What no Stokes vector explains of samples [n, R, W, C], of their light (root mean squares)."""
    light = float(np.sqrt(np.mean(np.square(samples, dtype=np.float64))))
    return float(np.sqrt(np.mean(np.square(residuals(samples, design), dtype=np.float64)))) / max(light, 1e-300)


def sample_noise(samples: NDArray[np.float32], design: NDArray[np.float64]) -> float:
    """Standard deviation of a sample, from the residuals (n - 3 degrees of freedom)."""
    residual = residuals(samples, design)
    return float(np.median(np.abs(residual)) / 0.6745 * np.sqrt(len(design) / (len(design) - 3)))


def moved(samples: NDArray[np.float32], design: NDArray[np.float64]) -> bool:
    """Whether residuals follow edges, as they do where the pictures of a stack do not lie on each other."""
    residual = np.abs(residuals(samples, design)).max(0).mean(-1)
    grey = samples.mean((0, -1))
    gradient = np.abs(np.gradient(grey, axis=1))
    strong = gradient > np.percentile(gradient, 95)
    flat = gradient < np.percentile(gradient, 50)
    if strong.sum() < 50 or not flat.any() or not gradient[strong].mean() > 0:
        return False
    excess = float(residual[strong].mean() - residual[flat].mean())
    return excess > MOVED * float(gradient[strong].mean())


def angles_misfit(samples: NDArray[np.float32], design: NDArray[np.float64]) -> bool:
    """Whether smooth residuals rival the polarised part: the angles are not those that the names tell."""
    residual = residuals(samples, design).mean(-1)
    step = np.diff(residual, axis=-1)
    noise = float(np.median(np.abs(step - np.median(step)))) / 0.6745 / np.sqrt(2)
    stokes = np.einsum("kn,nrw->krw", np.linalg.pinv(design), samples.mean(-1))
    lit = stokes[0] > 0.05 * np.percentile(stokes[0], 99)
    if lit.sum() < 50:
        return False
    size = float(np.median(np.abs(residual).max(0)[lit]))
    return size > 5 * noise and size > MISFIT * float(np.median(np.hypot(stokes[1], stokes[2])[lit]))


def twins(samples: NDArray[np.float32]) -> bool:
    """Whether two angles' samples [n, R, W, C] are the same in every digit, which noise alone prevents, and no plain grey."""
    for k, picture in enumerate(samples):
        if picture.size and np.ptp(picture) > 0 and any(np.array_equal(picture, other) for other in samples[k + 1 :]):
            return True
    return False
