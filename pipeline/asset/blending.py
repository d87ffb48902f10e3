"""Each texel's value: the robust mean of the views that see it best."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.rays import RayMesh

from .blend_kernel import robust_mean, sample
from .choice import BEST, Choice, Points, usable_pixels
from .views import PropertyViews

BLOCK_BYTES = 1 << 29  # of samples that are held at once; more texels go in blocks, and the views are gone through again
NOISE = 0.01  # deviations that mean nothing, of values of order one: what eight bits cannot show
DETAIL = 3  # channels

Advance = Callable[[int], None]


def blend(
    points: Points, mesh: RayMesh, views: PropertyViews, channels: int, advance: Advance
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """(values [T, C], detail [T, 3], whether any view sees the point [T]); values are 0 where none does.

    `mesh` blocks the view. `advance` is told how many views were gone through; twice len(views) in all where memory allows.
    """
    choice = Choice(points, mesh)
    for number, view in enumerate(views):
        choice.offer(number, view)
        advance(1)
    count = len(points.position)
    values, detail = np.zeros((count, channels), np.float32), np.zeros((count, DETAIL), np.float32)
    block = max(1, BLOCK_BYTES // (4 * BEST * (channels + DETAIL + 2)))
    for start in range(0, count, block):
        part = slice(start, start + block)
        values[part], detail[part] = _block(points.position[part], choice.view[part], choice.weight[part], views, channels)
        advance(len(views) if start == 0 else 0)
    return values, detail, np.asarray(choice.weight.any(1))


def _block(
    position: NDArray[np.float32], chosen: NDArray[np.int16], weight: NDArray[np.float32], views: PropertyViews, channels: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Robust means of some texels' samples: values [T, C] and detail [T, 3]."""
    count = len(position)
    samples, details = np.zeros((count, BEST, channels), np.float32), np.zeros((count, BEST, DETAIL), np.float32)
    weights, detail_weights = np.zeros((count, BEST), np.float32), np.zeros((count, BEST), np.float32)
    for number, view in enumerate(views):
        texel, place = np.nonzero(chosen == number)
        if not len(texel):
            continue
        pixels, _ = view.camera.project(position[texel].astype(np.float64))
        usable = usable_pixels(view)
        samples[texel, place], share = _sampled(view.values, usable, pixels)
        weights[texel, place] = np.where(share > 0, weight[texel, place], 0)
        if view.detail is not None and view.detail_weight is not None:
            details[texel, place], share = _sampled(view.detail, usable * view.detail_weight, pixels)
            detail_weights[texel, place] = weight[texel, place] * share
    values, detail = np.zeros((count, channels), np.float32), np.zeros((count, DETAIL), np.float32)
    robust_mean(samples, weights, np.full(channels, NOISE, np.float32), values, np.empty_like(values))
    error = np.empty_like(detail)
    robust_mean(details, detail_weights, np.full(DETAIL, NOISE, np.float32), detail, error)
    return values, detail * _certain(detail, error)


def _certain(detail: NDArray[np.float32], error: NDArray[np.float32]) -> NDArray[np.float32]:
    """How much [T, 1] of a detail is more than the views' noise: James and Stein's estimator, its positive part."""
    noise, whole = ((x**2).sum(1, keepdims=True) for x in (error, detail))
    return np.asarray(1 - np.minimum(noise / np.maximum(whole, np.finfo(np.float32).tiny), 1), np.float32)


def _sampled(image: NDArray, weight: NDArray, pixels: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    values, share = np.empty((len(pixels), image.shape[-1]), np.float32), np.empty(len(pixels), np.float32)
    x, y = (np.ascontiguousarray(p) for p in pixels.T)
    sample(np.ascontiguousarray(image, np.float32), np.ascontiguousarray(weight, np.float32), x, y, values, share)
    return values, share
