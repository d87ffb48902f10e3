"""Object and background told apart by colour: two histograms learnt from soft labels, over all views together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

BINS = (24, 32, 32)
"""Of log luminance and two log ratios of colours: shading moves along the first axis alone."""
BLUR_BINS = 1.0
FLOOR = 0.02
"""Of the median luminance, added before the logarithm: noise in the dark stays within a bin."""
MAX_LOG_ODDS = 4.0
"""What one pixel's colour may say at most: labels are never better than that."""
CONFUSION = 0.02
"""Share of either class that looks like the other (mixed edge pixels, highlights)."""
OWN_BACKGROUND = 0.7
"""Weight of a view's own background colours; the rest is what all views see behind the object."""


@dataclass(frozen=True)
class ColourSpace:
    """Ranges of the features; the same for all views of a capture."""

    floor: float
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @classmethod
    def of(cls, images: list[NDArray[np.float32]]) -> ColourSpace:
        """Ranges that hold 99 % of the pixels of linear images [h, w, 3]."""
        sample = np.concatenate([image.reshape(-1, 3)[::7] for image in images]).astype(np.float64)
        level = float(np.median(np.maximum(sample, 0).mean(-1)))
        floor = FLOOR * level if level > 0 else 1.0
        features = _features(sample, floor)
        low, high = np.percentile(features, 0.5, axis=0), np.percentile(features, 99.5, axis=0)
        return cls(floor, low, np.maximum(high, low + 1e-3))  # grey images have no spread of colour

    def bins(self, image: NDArray[np.float32]) -> NDArray[np.int64]:
        """Histogram bin of every pixel [h, w]."""
        count = np.array(BINS)
        cell = (_features(image, self.floor) - self.low) / (self.high - self.low) * count
        i, j, k = np.moveaxis(np.clip(cell.astype(np.int64), 0, count - 1), -1, 0)
        return (i * BINS[1] + j) * BINS[2] + k


def _features(rgb: NDArray, floor: float) -> NDArray:
    logs = np.log(np.maximum(rgb, 0) + floor)
    return np.stack([logs.mean(-1), logs[..., 0] - logs[..., 1], logs[..., 2] - logs[..., 1]], -1)


def histogram(bins: NDArray[np.int64], weights: NDArray) -> NDArray[np.float64]:
    """Weighted, blurred colour counts, flat."""
    counts = np.bincount(bins.ravel(), weights=weights.ravel(), minlength=int(np.prod(BINS)))
    return gaussian_filter(counts.reshape(BINS), BLUR_BINS).ravel()


def colour_log_odds(
    bins: list[NDArray[np.int64]], probability: list[NDArray[np.float64]], leak_quantile: float = 0.7
) -> list[NDArray[np.float64]]:
    """Log odds of object against background of every pixel, from the current soft labels.

    Labels of the object still hold background; as the background's colours are known from where the object cannot be,
    that share is found (the ratio of the two histograms over the bulk of the background) and taken out.
    """
    inside = np.sum([histogram(b, p) for b, p in zip(bins, probability)], axis=0)
    behind = [histogram(b, np.where(p < 0.5, (1 - p) ** 2, 0)) for b, p in zip(bins, probability)]
    everywhere = np.sum(behind, axis=0)
    inside, everywhere = inside / max(inside.sum(), 1e-12), everywhere / max(everywhere.sum(), 1e-12)
    ratio = inside / (everywhere + 1e-9)
    order = np.argsort(ratio, kind="stable")
    reached = np.searchsorted(np.cumsum(everywhere[order]), leak_quantile)
    leak = ratio[order][min(reached, len(order) - 1)]
    pure = np.maximum(inside - leak * everywhere, 0)
    pure = pure / pure.sum() if pure.sum() > 0 else inside
    out = []
    for b, own in zip(bins, behind):
        outside = OWN_BACKGROUND * own / max(own.sum(), 1e-12) + (1 - OWN_BACKGROUND) * everywhere
        f, g = pure[b], outside[b]
        unseen = 1e-6  # a colour that neither class has shown says nothing
        odds = np.log((f + CONFUSION * g + unseen) / (g + CONFUSION * f + unseen))
        out.append(np.clip(odds, -MAX_LOG_ODDS, MAX_LOG_ODDS))
    return out
