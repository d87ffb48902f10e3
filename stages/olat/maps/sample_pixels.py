"""Pixels whose samples are kept beside the maps, for pictures of the fit: an even grid of a few hundred over the object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.kept_samples import NUMBERS, KeptSamples, write_kept_samples
from stages.olat.pixel_fit.result_layout import map_slices
from stages.olat.reading.frame_reader import Samples

COUNT = 400  # a camera: 20 across a round object; 346 lights are then 2 MB


def grid_of(mask: NDArray[np.bool_], count: int = COUNT) -> NDArray[np.intp]:
    """Choose pixels evenly over an object.

    Args:
        mask: the object. [H, W]
        count: about how many, at most.

    Returns:
        Flat indices, ascending; at least one of an object.
    """
    step = max(1, int(np.ceil(np.sqrt(mask.sum() / count))))
    grid = np.zeros_like(mask)
    grid[step // 2 :: step, step // 2 :: step] = True
    found = np.flatnonzero(mask & grid)
    return found if len(found) else np.flatnonzero(mask)[:count]


class SampleKeeper:
    """Collects what the chosen pixels of one camera measured, and what was fitted to it, band by band."""

    def __init__(self, mask: NDArray[np.bool_], lights: NDArray[np.int64], both: bool) -> None:
        """Choose the pixels; lights [L]: the table's that are used; both: the camera has crossed and parallel frames."""
        self.chosen, self.lights, self.both = grid_of(mask), lights, both
        self.parts: list[tuple[NDArray, NDArray, NDArray, NDArray]] = []

    def add(self, samples: Samples, rows: NDArray[np.float64], first: int) -> None:
        """Take in rows [P, WIDTH] that were fitted to the pixels of `samples` from the first-th on."""
        pixels = samples.band.pixels[first : first + len(rows)]
        own = np.flatnonzero(np.isin(pixels, self.chosen, assume_unique=True))
        if len(own):
            cross, parallel = (_halves(side[:, first + own]) for side in (samples.cross, samples.parallel))
            self.parts.append((pixels[own], cross, parallel, rows[own]))

    def write(self, path: Path) -> None:
        """Write what was collected, if anything was."""
        if not self.parts:
            return
        pixels = np.concatenate([part[0] for part in self.parts]).astype(np.int64)
        cross, parallel = (np.concatenate([part[k] for part in self.parts], 1).swapaxes(0, 1) for k in (1, 2))
        rows, places = np.concatenate([part[3] for part in self.parts]), map_slices()
        numbers = {name: np.asarray(rows[:, places[name]], np.float32) for name in NUMBERS}
        write_kept_samples(path, KeptSamples(pixels, self.lights, cross, parallel if self.both else None, numbers))


def _halves(samples: NDArray) -> NDArray[np.float16]:
    """Half floats of samples that are such (their bits) or floats."""
    with np.errstate(over="ignore"):
        return samples.view(np.float16) if samples.dtype == np.uint16 else samples.astype(np.float16)
