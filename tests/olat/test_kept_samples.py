"""Samples of a few hundred pixels are kept beside the maps: an even grid, as read, with the fit's own numbers."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.rig.kept_samples import read_kept_samples
from stages.olat.maps.sample_pixels import COUNT, SampleKeeper, grid_of
from stages.olat.pixel_fit.result_layout import WIDTH, map_slices
from stages.olat.reading.frame_reader import Samples
from stages.olat.reading.scanline_bands import Band


def test_the_grid_is_even_and_no_finer_than_wanted():
    rows, columns = np.indices((300, 400))
    mask = (rows - 150) ** 2 + (columns - 200) ** 2 < 140**2
    found = grid_of(mask)
    assert mask.ravel()[found].all() and 0.8 * COUNT < len(found) <= 1.1 * COUNT
    rows, columns = np.divmod(found, 400)
    assert len(set(np.diff(np.unique(rows)))) == 1 == len(set(np.diff(np.unique(columns))))
    thin = np.zeros((40, 40), bool)
    thin[1] = True
    assert len(grid_of(thin, 5)) > 0


@pytest.mark.parametrize("half", [True, False])
def test_what_is_kept_of_bands_is_what_was_read_and_fitted(tmp_path, half):
    rng, mask = np.random.default_rng(0), np.ones((12, 10), bool)
    cross, parallel = rng.uniform(size=(2, 5, 120, 3)).astype(np.float16)
    rows = rng.uniform(size=(120, WIDTH))
    keeper = SampleKeeper(mask, np.array([0, 2, 4, 6, 8]), both=True)
    keeper.chosen = np.array([3, 17, 63, 99])

    def stored(values: np.ndarray) -> np.ndarray:
        return values.view(np.uint16) if half else values.astype(np.float32)

    for top, bottom in ((0, 6), (6, 12)):
        pixels = np.arange(10 * top, 10 * bottom)
        samples = Samples(Band(top, bottom, pixels), stored(cross[:, pixels].copy()), stored(parallel[:, pixels].copy()))
        for first in (0, 30):  # a band is fitted in parts
            keeper.add(samples, rows[pixels[first : first + 30]], first)
    keeper.write(tmp_path / "samples.npz")
    found = read_kept_samples(tmp_path / "samples.npz")
    assert found.pixels.tolist() == keeper.chosen.tolist() and found.lights.tolist() == [0, 2, 4, 6, 8]
    assert np.array_equal(found.cross, cross[:, keeper.chosen].swapaxes(0, 1))
    assert found.parallel is not None and np.array_equal(found.parallel, parallel[:, keeper.chosen].swapaxes(0, 1))
    assert np.allclose(found.numbers["sigma"], rows[keeper.chosen, map_slices()["sigma"]], rtol=1e-6)
    again = tmp_path / "again.npz"
    keeper.write(again)
    assert again.read_bytes() == (tmp_path / "samples.npz").read_bytes()
