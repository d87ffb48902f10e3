"""The direct EXR reader gives what OpenImageIO gives, and leaves to it what it does not understand."""

import numpy as np
import OpenImageIO as oiio
import pytest

from pipeline.capture.config import RadiometryConfig
from pipeline.capture.pixels.linear import read_linear
from pipeline.errors import UserError
from pipeline.formats.exr_zip import open_zip_exr
from pipeline.formats.images import STOKES, read_image


def write(path, pixels, kind="half", compression="zip", names=STOKES, **header):
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, kind)
    spec.channelnames = tuple(names[:count])
    spec.attribute("compression", compression)
    for key, value in header.items():
        setattr(spec, key, value)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(np.ascontiguousarray(pixels, np.float32)) and out.close()
    return path


def scene(height=37, width=53, count=9):
    """Smooth above, noise below (chunks that zip would make larger are stored), with what is not finite, and tiny values."""
    pixels = np.random.default_rng(0).normal(size=(height, width, count)).astype(np.float32)
    pixels[: height // 2] = np.linspace(0, 1, width)[:, None]
    pixels[3, 4, 0], pixels[3, 5, 1], pixels[3, 6, 2] = np.nan, np.inf, 1e-7
    return pixels


@pytest.mark.parametrize("kind", ["half", "float"])
@pytest.mark.parametrize("compression", ["zip", "zips"])
def test_samples_are_those_of_openimageio(tmp_path, kind, compression):
    path = write(tmp_path / "a.exr", scene(), kind, compression)
    reader = open_zip_exr(path)
    assert reader is not None
    reader.file.close()
    with np.errstate(invalid="ignore"):
        found = read_linear(path, RadiometryConfig())
    np.testing.assert_array_equal(found.pixels, read_image(path))
    assert found.channels(STOKES, path).shape == (37, 53, 9)


def test_a_cropped_data_window_starts_at_its_own_first_row(tmp_path):
    path = write(tmp_path / "a.exr", scene(), y=-7, x=3, full_width=80, full_height=80)
    np.testing.assert_array_equal(read_linear(path, RadiometryConfig()).pixels, read_image(path))


@pytest.mark.parametrize("case", [{"compression": "piz"}, {"tile_width": 16, "tile_height": 16}, {"compression": "rle"}])
def test_other_exr_files_are_left_to_openimageio(tmp_path, case):
    path = write(tmp_path / "a.exr", np.abs(np.nan_to_num(scene(), posinf=1)), **case)
    assert open_zip_exr(path) is None
    np.testing.assert_allclose(read_linear(path, RadiometryConfig()).pixels, read_image(path))


def test_damage_anywhere_is_one_line_or_openimageios_own_word(tmp_path):
    path = write(tmp_path / "a.exr", scene())
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(60):
        damaged = bytearray(whole[: rng.integers(40, len(whole))] if rng.random() < 0.5 else whole)
        damaged[rng.integers(0, len(damaged))] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            read_linear(path, RadiometryConfig())
        except UserError as fault:
            assert "\n" not in str(fault)


@pytest.mark.parametrize("name", ["lineOrder", "compression"])
def test_a_header_that_openexr_would_refuse_is_left_to_it(tmp_path, name):
    """Else decode would pass on a file that no later stage can read."""
    path = write(tmp_path / "a.exr", scene())
    damaged = bytearray(path.read_bytes())
    at = damaged.index(name.encode() + b"\0")  # the name, then the type, then the length
    at = damaged.index(b"\0", at + len(name) + 1) + 1
    damaged[at] ^= 4
    path.write_bytes(damaged)
    assert open_zip_exr(path) is None
    with pytest.raises(UserError, match=r"a\.exr"):
        read_linear(path, RadiometryConfig())


def test_rows_stored_from_the_bottom_up_are_read(tmp_path):
    path = tmp_path / "a.exr"
    spec = oiio.ImageSpec(53, 37, 9, "half")
    spec.channelnames = STOKES
    spec.attribute("compression", "zip")
    spec.attribute("openexr:lineOrder", "decreasingY")
    out = oiio.ImageOutput.create(str(path))
    pixels = np.ascontiguousarray(scene())
    assert out.open(str(path), spec) and out.write_image(pixels) and out.close()
    reader = open_zip_exr(path)
    assert reader is not None
    reader.file.close()
    np.testing.assert_array_equal(read_linear(path, RadiometryConfig()).pixels, read_image(path))


def test_a_chunk_that_lies_far_from_the_others_is_read(tmp_path):
    path = write(tmp_path / "a.exr", scene())
    wanted = read_image(path)
    reader = open_zip_exr(path)
    reader.file.close()
    data = bytearray(path.read_bytes())
    table = len(reader.layout.header)
    first = int.from_bytes(data[table : table + 8], "little")
    size = 8 + int.from_bytes(data[first + 4 : first + 8], "little")
    moved = len(data) + 1_000_000
    chunk = data[first : first + size]
    data[table : table + 8] = moved.to_bytes(8, "little")
    path.write_bytes(data + bytes(1_000_000) + chunk)
    np.testing.assert_array_equal(read_linear(path, RadiometryConfig()).pixels, wanted)
