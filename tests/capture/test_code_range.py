"""Sensor codes of 10, 12 and 14 bits in 16-bit files: their white level is found where clipping shows it."""

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.capture.radiometry.code_range import code_range
from tests.capture.little_captures import ANGLES, behind, mosaic, stokes, write


def mosaics(root, bits, gain=6, shift=0, suffix="png"):
    for i in range(3):
        codes = np.round(np.clip(mosaic(stokes(i)) * gain, 0, 1) * (2**bits - 1)).astype(np.uint16) << shift
        write(root / "images" / f"{i}.{suffix}", codes, "Y")
    return open_capture(root)


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_clipped_codes_of_fewer_bits_are_recognised_and_marked(tmp_path, bits, suffix):
    capture = mosaics(tmp_path, bits, suffix=suffix)
    (line,) = capture.warnings
    assert f"radiometry.white_level = {2**bits - 1}" in line
    view = capture.views[0].read()
    clipped = mosaic(stokes(0)) * 6 > 1
    assert view.saturated[clipped].all() and not view.saturated.all()
    inner = ~view.saturated
    assert np.median(view.stokes[inner][:, 0, 0] / stokes(0)[inner][:, 0].mean(-1)) == pytest.approx(6, rel=0.02)


def test_stacks_and_photographs_too(tmp_path):
    for angle in ANGLES:
        codes = np.round(np.clip(behind(stokes(0), angle) * 5, 0, 1) * 4095).astype(np.uint16)
        write(tmp_path / "stack" / "images" / f"a_{angle:03d}.tif", codes)
        write(tmp_path / "photographs" / "images" / f"{'abcd'[ANGLES.index(angle)]}.tif", codes)
    for name in ("stack", "photographs"):
        capture = open_capture(tmp_path / name)
        assert "radiometry.white_level = 4095" in capture.warnings[0]
    assert open_capture(tmp_path / "photographs").views[0].read().saturated.any()


def test_codes_moved_to_the_top_of_sixteen_bits_are_read_and_marked(tmp_path):
    capture = mosaics(tmp_path, 12, shift=4)
    assert capture.warnings == ()
    view = capture.views[0].read()
    assert view.saturated.any() and view.stokes[..., 0, 0].max() < 3
    inner = ~view.saturated
    assert np.median(view.stokes[inner][:, 0, 0] / stokes(0)[inner][:, 0].mean(-1)) == pytest.approx(6, rel=5e-3)


def test_twelve_bits_moved_up_within_fourteen(tmp_path):
    assert "white_level = 16380" in mosaics(tmp_path, 12, shift=2).warnings[0]


def test_what_is_specified_is_not_searched(tmp_path):
    mosaics(tmp_path, 12)
    (tmp_path / "capture.toml").write_text("radiometry.white_level = 4095\n")
    capture = open_capture(tmp_path)
    assert capture.warnings == () and capture.views[0].read().saturated.any()


@pytest.mark.parametrize("gain", [0.9, 1.5])
def test_whole_sixteen_bits_and_dark_pictures_say_nothing(tmp_path, gain):
    assert mosaics(tmp_path / "whole", 16, gain).warnings == ()
    assert mosaics(tmp_path / "dark", 12, 0.9).warnings == ()


def test_codes_that_end_low_without_clipping_are_told(tmp_path):
    found = {bits: mosaics(tmp_path / f"{bits}", bits, gain) for bits, gain in ((10, 2.0), (12, 4.0), (16, 2.0))}
    said = {bits: [f for f in (*capture.warnings, *capture.facts) if "_level" in f] for bits, capture in found.items()}
    assert "radiometry.white_level = 1023" in said[10][0] and "radiometry.white_level = 4095" in said[12][0] and not said[16]
    assert [len(found[bits].warnings) for bits in (10, 12, 16)] == [0, 1, 0]  # the commonest sensors', well exposed


def test_an_even_background_is_no_clipping():
    image = np.full((64, 64), 30000, np.uint16)
    image[20:40, 20:40] = np.arange(400).reshape(20, 20) * 50
    assert code_range([image]) is None


def test_a_white_level_beyond_every_code_marks_nothing_as_saturated():
    from pipeline.capture.config import RadiometryConfig
    from pipeline.capture.pixels.row_bands import code_table

    table, limit = code_table(8, RadiometryConfig(white_level=1e300), "linear")
    assert limit == len(table) and np.isfinite(table).all()
