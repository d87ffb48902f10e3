"""Pixels that look through an opening of the surface at its unlit back, and how much of its rim's pixels is opening."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pipeline.formats.backdrop import grown

from .source_views import SourceView

OPENING = 2.5e-3  # radiance (mean foreground = 0.25) below which no outer side of any dielectric under a sky is: 1/100 of
# the mean, when its mirror reflection alone gives a twentieth
MOST_OPEN = 0.15  # mean share of black pixels above which they are unlit sides, not openings: a teapot's are 0.016, those
# of a bowl seen from all around 0.07, an object lit by one lamp is dark on a third or more
SMALLEST_OPENING = 3  # pixels: fewer are dead pixels
LIT = 4.0  # a patch's level over the usual step between its pixels above which it is an image; noise about black stays below 1


def opening_pixels(source: SourceView, exposure: float) -> np.ndarray:
    """Pixels inside the mask that hold no light at all [H, W]: the image looks through an opening at a surface's back.

    A scan or a model of a vessel is often a surface without thickness, whose back no renderer lights. What a strong sun
    leaves in the shade is as dark beside the rest, but holds an image: patches that are smooth beside their level are lit.
    """
    dark = (np.abs(source.image[:, :, 0]).max(-1) * exposure < OPENING) & (source.mask > 0.99) & source.valid
    parts, count = ndimage.label(dark)
    if not count:
        return dark
    index = np.arange(1, count + 1)
    light = source.image[:, :, 0].mean(-1)
    level = np.asarray(ndimage.median(light, parts, index))
    rough = _roughness(light, parts, index)
    large = ndimage.sum_labels(dark, parts, index) >= SMALLEST_OPENING
    return np.isin(parts, index[large & ~(level > LIT * rough)])


def _roughness(values: np.ndarray, parts: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Usual step between neighbouring pixels that noise alone would make, for each labelled part.

    From second differences, which a slope leaves out, over sqrt(3): a noise's are as much larger than its first ones.
    Parts without three pixels in a row are judged by first differences.
    """
    found = []
    for order, scale in ((2, 3**-0.5), (1, 1.0)):
        steps, owners = [], []
        for image, label in ((values, parts), (values.T, parts.T)):
            ends = label[order:], label[:-order]
            same = (ends[0] == ends[1]) & (label[1 : len(label) - order + 1] == ends[0])
            steps.append((scale * np.abs(np.diff(image, order, axis=0))).ravel())
            owners.append((ends[0] * same).ravel())
        owner = np.concatenate(owners)
        there = np.bincount(owner, minlength=len(index) + 1)[index] > 0
        found.append(np.where(there, ndimage.median(np.concatenate(steps), owner, index), np.nan))
    return np.where(np.isfinite(found[0]), found[0], np.nan_to_num(found[1]))


def hole_coverage(source: SourceView, exposure: float) -> np.ndarray:
    """How far each pixel looks into an opening [H, W]: 1 in it, at its rim what is missing of the brightness beside."""
    opening = opening_pixels(source, exposure)
    bright = source.image[:, :, 0].max(-1)
    full = np.asarray(ndimage.maximum_filter(np.where(opening, 0.0, bright), 5))
    rim = grown(opening) & ~opening & (source.mask > 0.99)
    share = 1 - bright / np.maximum(full, 1e-30)  # 0 / 0 where all about is black, which is no rim
    return np.where(opening, 1.0, np.where(rim, np.clip(share, 0.0, 1.0), 0.0))


def has_openings(sources: list[SourceView], exposure: float) -> bool:
    """Whether the training views look into openings: some pixels are black, but not so many that it is for lack of light."""
    shares = [opening_pixels(s, exposure).sum() / max((s.mask > 0.99).sum(), 1) for s in sources if s.split != "test"]
    return bool(shares) and 0 < float(np.mean(shares)) <= MOST_OPEN
