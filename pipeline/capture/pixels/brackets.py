"""Exposure brackets to one linear image: every unsaturated sample weighted by its noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import RadiometryConfig
from pipeline.capture.naming.grouping import Exposure
from pipeline.capture.pixels.bracket_levels import bracket_doubt
from pipeline.capture.pixels.linear import read_linear
from pipeline.capture.pixels.linear_image import LinearImage
from pipeline.capture.radiometry.exposure import known_seconds
from pipeline.errors import UserError

READ_NOISE = 2e-3
"""Of the white level: a sensor's read noise, which decides the weights in the dark (8 of 4096 codes)."""


def read_exposures(
    exposures: Sequence[Exposure], radiometry: RadiometryConfig, sensor_data: bool = False, view: str | None = None
) -> LinearImage:
    """One `view`'s exposures as one linear image: a single file as it is, several merged per second of exposure.

    Raises UserError where a file's exposure is not known by name, EXIF or capture.toml, or sizes differ.
    """
    images = [read_linear(e.path, radiometry, sensor_data, e.page) for e in exposures]
    known = [_seconds(e, image, radiometry, view) for e, image in zip(exposures, images)]
    if len(images) == 1:
        image, seconds = images[0], known_seconds(exposures[0].path, view, radiometry.exposure_s)
        if seconds:
            for k in image.colours:
                image.pixels[..., k] /= np.float32(seconds)
        return image
    first = images[0]
    for e, image in zip(exposures, images):
        if image.pixels.shape != first.pixels.shape:
            (height, width), (h, w) = image.pixels.shape[:2], first.pixels.shape[:2]
            raise UserError(e.path, f"is {width}x{height}, its bracket {w}x{h}", "one size a bracket")
    for e, seconds in zip(exposures, known):
        if seconds is None:
            raise UserError(e.path, "its exposure is unknown", "name it _ev+1 or _exp0.01, or set radiometry.exposure_s")
    times = [float(s) for s in known if s is not None]
    light = [i.pixels if i.alpha is None else i.pixels[..., i.colours] for i in images]
    clipped = [i.saturated for i in images]
    linear = all(i.encoding == "linear" for i in images)
    doubt = bracket_doubt(light, clipped, times) if linear else None  # a curve is not the same at all levels
    pixels, lost = merge_exposures(light, clipped, times)
    if first.alpha is not None:
        first.pixels[..., first.colours] = pixels
        pixels = first.pixels  # with its own alpha
    return LinearImage(pixels, first.names, lost, first.bits, first.orientation, None, first.encoding, first.frame, doubt)


def merge_exposures(
    images: Sequence[NDArray[np.float32]], saturated: Sequence[NDArray[np.bool_]], seconds: Sequence[float]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Radiance per second [H, W, C] of linear exposures, and where every exposure is saturated [H, W].

    A sample x of exposure t estimates x / t with variance (x + r) / t² (shot and read noise, in units of the white
    level): weights t² / (x + r). Where all are saturated the shortest stands.
    """
    total, weights = np.zeros_like(images[0]), np.zeros_like(images[0])
    for image, clipped, t in zip(images, saturated, seconds):
        w = np.where(clipped[..., None], 0, np.float32(t * t) / (np.maximum(image, 0) + np.float32(READ_NOISE)))
        total += w * image / np.float32(t)
        weights += w
    lost = (weights == 0).any(-1)
    shortest = int(np.argmin(seconds))
    fallback = images[shortest] / np.float32(seconds[shortest])
    with np.errstate(invalid="ignore", divide="ignore"):
        merged = np.where(weights > 0, total / weights, fallback)
    return merged.astype(np.float32), lost


def _seconds(exposure: Exposure, image: LinearImage, radiometry: RadiometryConfig, view: str | None) -> float | None:
    known = known_seconds(exposure.path, None if radiometry.exposure_s.get(view or "") is None else view, radiometry.exposure_s)
    if known is not None:
        return known
    if exposure.seconds is not None:
        return exposure.seconds
    if exposure.stops is not None:
        return float(2.0**exposure.stops)
    return image.exposure_s
