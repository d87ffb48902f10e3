"""Has the object or the camera moved between the crossed and the parallel pass? Measured on the passes' mean images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.olat.frames import Samples, bands_of, read_bands

ALIGN_LIGHTS = 32  # a pass, of which `EVERY`-th are looked at: enough edges to see a shift before the fits
WARN_PX = 0.5  # a shift that mixes neighbouring pixels
EVERY = 4  # lights: enough for a mean image
SIDE = 960  # pixels of the longer side at which the shift is measured


class Drift:
    """Collects the mean image of each pass, band by band, at no more than `SIDE` pixels."""

    def __init__(self, width: int, height: int) -> None:
        """Empty means for frames of this size."""
        self.width = width
        self.step = max(1, -(-max(width, height) // SIDE))
        self.means = np.zeros((2, -(-height // self.step), -(-width // self.step)))

    def add(self, samples: Samples) -> None:
        """Take in a band."""
        rows, columns = np.divmod(samples.band.pixels, self.width)
        on = (rows % self.step == 0) & (columns % self.step == 0)
        for k, data in enumerate((samples.cross, samples.parallel)):
            part = data[::EVERY, on]
            values = part.view(np.float16) if part.dtype == np.uint16 else part
            mean = np.nan_to_num(values.astype(np.float32), posinf=0, neginf=0).mean((0, 2))
            self.means[k, rows[on] // self.step, columns[on] // self.step] = mean

    def shift(self) -> tuple[float, float]:
        """(right, down) shift in pixels of the parallel pass against the crossed one; (0, 0) where nothing can be told."""
        inside = self.means[0] > 0
        if inside.sum() < 64:
            return 0.0, 0.0
        rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
        crop = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        edges = [_edges(image[crop]) for image in self.means]
        if min(crop[0].stop - crop[0].start, crop[1].stop - crop[1].start) < 16 or not all(e.any() for e in edges):
            return 0.0, 0.0
        down, right = phase_shift(edges[0], edges[1])
        return right * self.step, down * self.step


def phase_shift(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, float]:
    """(down, right) shift of image b against a: the peak of their phase correlation, to a tenth of a pixel by a parabola."""
    spectrum = np.conj(np.fft.fft2(a)) * np.fft.fft2(b)
    peak = np.fft.ifft2(spectrum / np.maximum(np.abs(spectrum), 1e-12 * np.abs(spectrum).max())).real
    at = np.unravel_index(int(np.argmax(peak)), peak.shape)
    found = []
    for axis in (0, 1):
        line = np.take(peak, at[1 - axis], axis=1 - axis)
        k, size = int(at[axis]), len(line)
        before, middle, after = line[k - 1], line[k], line[(k + 1) % size]
        bend = 2 * middle - before - after
        k = k - size if k > size // 2 else k
        found.append(k + (0.5 * (after - before) / bend if bend > 0 else 0.0))
    return found[0], found[1]


def _edges(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Strength of relative change: what the diffuse and the shiny image of one object share."""
    log = np.log(np.maximum(image, 1e-3 * float(image.max() or 1.0)))
    return np.hypot(*np.gradient(log))


def measure(
    cross: list[Path], parallel: list[Path], mask: NDArray[np.bool_], half: bool, band_mb: float
) -> tuple[float, float]:
    """(right, down) shift of the parallel pass from a few lights of each. Raises UserError."""
    step = max(1, len(cross) // ALIGN_LIGHTS)
    few = cross[::step], parallel[::step]
    drift = Drift(mask.shape[1], mask.shape[0])
    for samples in read_bands(*few, bands_of(mask, len(few[0]), band_mb, 2 if half else 4), half):
        drift.add(samples)
    return drift.shift()
