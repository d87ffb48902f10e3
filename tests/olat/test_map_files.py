"""Maps are files that programs show: two numbers a pixel also stand as colours."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.errors import UserError
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


@pytest.mark.parametrize("spoil", ["table", "pixels", "end"])
def test_a_map_of_which_a_part_was_not_written_is_not_taken_for_whole(spoil, tmp_path):
    with MapWriter(tmp_path / "sound", 40, 40):
        pass
    writer = MapWriter(tmp_path / "cam00", 40, 40)
    out, path = writer.files["roughness"], tmp_path / "cam00" / "roughness.exr"

    def close() -> bool:  # what is left where one of OpenImageIO's own writes fails, of which it says nothing
        done = out.close()
        data = bytearray(path.read_bytes())
        table = next(at for at in range(len(data)) if int.from_bytes(data[at : at + 8], "little") == at + 24)  # of three chunks
        if spoil == "table":
            data[table : table + 24] = bytes(24)
        elif spoil == "pixels":
            data[-8:] = bytes(8)
        path.write_bytes(data[:-20] if spoil == "end" else data)
        return done

    writer.files["roughness"] = SimpleNamespace(close=close, write_scanlines=out.write_scanlines)
    with pytest.raises(UserError, match=r"roughness\.exr.*cannot be written"):
        writer.close()
