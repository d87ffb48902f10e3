"""Has the object or the camera moved between the crossed and the parallel pass? Measured on the passes' mean images."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.olat.reading.frame_reader import Samples, read_bands
from stages.olat.reading.scanline_bands import bands_of

ALIGN_LIGHTS = 8  # a pass: enough edges to see a shift before the fits
WARN_PX = 0.5  # a shift that mixes neighbouring pixels
EVERY = 8  # lights: enough for a mean image
LEAST_LIKENESS = 0.5  # correlation of the passes' edges below which nothing can be estimated
CLEARLY = 0.6  # of what no shift leaves unexplained: a shift must leave less
SIDE = 960  # pixels of the longer side at which the shift is measured


class Misregistration:
    """Collects the mean image of each pass, band by band, at no more than `SIDE` pixels."""

    def __init__(self, width: int, height: int, every: int = EVERY) -> None:
        """Empty means of each `every`-th light for frames of this size."""
        self.every = every
        self.width = width
        self.step = max(1, -(-max(width, height) // SIDE))
        self.means = np.zeros((2, -(-height // self.step), -(-width // self.step)))

    def add(self, samples: Samples) -> None:
        """Take in a band."""
        rows, columns = np.divmod(samples.band.pixels, self.width)
        on = np.flatnonzero((rows % self.step == 0) & (columns % self.step == 0)) if self.step > 1 else slice(None)
        for k, data in enumerate((samples.cross, samples.parallel)):
            self.means[k, rows[on] // self.step, columns[on] // self.step] = _mean([frame[on] for frame in data[:: self.every]])

    def shift(self) -> tuple[float, float]:
        """(right, down) shift in pixels of the parallel pass against the crossed one; (0, 0) where nothing can be estimated."""
        inside = self.means[0] > 0
        if inside.sum() < 64:
            return 0.0, 0.0
        rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
        crop = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        if min(crop[0].stop - crop[0].start, crop[1].stop - crop[1].start) < 16:
            return 0.0, 0.0
        crossed, parallel = (edges_of(image[crop], inside[crop]) for image in self.means)
        down, right = best_shift(crossed, parallel, inner_part(inside[crop]))
        return right * self.step, down * self.step


def _mean(frames: list[NDArray]) -> NDArray[np.float32]:
    """Mean over frames and channels of samples [P, 3] (half-float bits or floats), those that are not finite as 0."""

    def total(kept: Callable[[NDArray[np.float32]], NDArray[np.float32]]) -> NDArray[np.float32]:
        out = np.zeros(frames[0].shape, np.float32)
        for frame in frames:  # one by one they stay in the cache
            out += kept((frame.view(np.float16) if frame.dtype == np.uint16 else frame).astype(np.float32))
        return out

    with np.errstate(invalid="ignore"):
        found = total(lambda values: values)
    if not np.isfinite(found).all():
        found = total(lambda values: np.nan_to_num(values, posinf=0, neginf=0))
    return found.sum(1) / (3 * len(frames))


def best_shift(a: NDArray[np.float64], b: NDArray[np.float64], mask: NDArray[np.bool_]) -> tuple[float, float]:
    """(down, right) shift of image b against a, to a tenth of a pixel by a parabola; (0, 0) where none stands out.

    Normalised cross-correlation over the pixels that both masks hold (Padfield 2012): the outline of the mask, which does not
    move, has no say. At most an eighth of the object's size.
    """
    size = [2 * n for n in a.shape]

    def correlate(x: NDArray, y: NDArray) -> NDArray[np.float64]:
        return np.fft.irfft2(np.conj(np.fft.rfft2(x, size)) * np.fft.rfft2(y, size), size)

    m = mask.astype(float)
    x, y = a * m, b * m
    count = np.maximum(correlate(m, m), 1.0)
    sum_x, sum_y = correlate(x, m), correlate(m, y)
    top = correlate(x, y) - sum_x * sum_y / count
    spread_x, spread_y = correlate(x * x, m) - sum_x**2 / count, correlate(m, y * y) - sum_y**2 / count
    scale = np.sqrt(np.maximum(spread_x, 0) * np.maximum(spread_y, 0))
    ncc = np.divide(top, scale, out=np.zeros_like(top), where=(scale > 1e-9 * scale.max()) & (count > 0.5 * m.sum()))
    reach = max(2, max(a.shape) // 8)
    down, right = (np.minimum(np.arange(n), n - np.arange(n)) <= reach for n in size)
    ncc = np.where(down[:, None] & right[None, :], ncc, -1.0)
    at = np.unravel_index(int(np.argmax(ncc)), ncc.shape)
    if ncc[at] < LEAST_LIKENESS:
        return 0.0, 0.0
    if 1 - ncc[at] > CLEARLY * (1 - ncc[0, 0]):
        at = (np.intp(0), np.intp(0))
    found = []
    for axis in (0, 1):
        line = np.take(ncc, at[1 - axis], axis=1 - axis)
        k, n = int(at[axis]), len(line)
        before, middle, after = line[k - 1], line[k], line[(k + 1) % n]
        bend = 2 * middle - before - after
        k = k - n if k > n // 2 else k
        part = 0.5 * (after - before) / bend if bend > 0 else 0.0
        found.append(k + float(np.clip(part, -0.5, 0.5)))
    return found[0], found[1]


def edges_of(image: NDArray[np.float64], inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Strength of relative change: what the diffuse and the shiny image of one object share."""
    level = float(image[inside].max()) if inside.any() else 1.0
    return np.hypot(*np.gradient(np.log(np.maximum(image, 1e-3 * (level or 1.0)))))


def inner_part(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask without its two outermost pixels, where the background is in the edges."""
    padded = np.pad(inside, 2)
    for axis in (0, 1):
        for _ in range(2):
            padded = padded & np.roll(padded, 1, axis) & np.roll(padded, -1, axis)
    return padded[2:-2, 2:-2]


def measure(cross: list[Path], parallel: list[Path], mask: NDArray[np.bool_], half: bool, band_mb: float) -> Misregistration:
    """The passes' mean images from a few lights of each. Raises UserError."""
    step = max(1, len(cross) // ALIGN_LIGHTS)
    few = cross[::step], parallel[::step]
    found = Misregistration(mask.shape[1], mask.shape[0], 1)
    bands = bands_of(mask, len(few[0]), band_mb, 2 if half else 4)
    for samples in read_bands(*few, bands, (mask.shape[1], mask.shape[0]), half):
        found.add(samples)
    return found
