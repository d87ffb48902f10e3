"""Maps are files that programs show: two numbers a pixel also stand as colours."""

from __future__ import annotations

import numpy as np

from pipeline.formats.images import channel_names, read_image
from stages.olat.maps.map_files import MapWriter
from stages.olat.pixel_fit.result_layout import WIDTH, map_slices
from stages.olat.reading.scanline_bands import Band


def test_widths_and_flags_stand_as_colours_beside_their_names(tmp_path):
    rows = np.arange(4 * WIDTH, dtype=np.float64).reshape(4, WIDTH) / 1000
    with MapWriter(tmp_path, 6, 4) as writer:
        writer.write(Band(1, 3, np.array([7, 8, 13, 14])), rows)
    for name, own in (("sigma", ("X", "Y")), ("residual", ("Y", "flag"))):
        path = tmp_path / f"{name}.exr"
        assert set(channel_names(path)) == {*own, "R", "G", "B"}
        numbers, shown = read_image(path, own), read_image(path, ("R", "G", "B"))
        assert np.array_equal(numbers[1, 1:3].astype(np.float32), rows[:2, map_slices()[name]].astype(np.float32))
        assert np.allclose(shown[..., :2], numbers, rtol=1e-3) and not shown[..., 2].any()
    assert set(channel_names(tmp_path / "roughness.exr")) == {"Y"}
