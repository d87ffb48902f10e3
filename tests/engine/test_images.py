"""Images keep their numbers: names not order, halves never overflow, bytes depend on pixels alone, faults in one line."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.images import (
    read_exr,
    read_image,
    read_mask,
    read_stokes,
    srgb_decode,
    srgb_encode,
    write_exr,
    write_mask,
    write_png,
    write_rgb,
    write_stokes,
)


def test_stokes_images_round_trip_by_name(tmp_path):
    stokes = np.random.default_rng(0).normal(size=(7, 5, 3, 3)).astype(np.float32)
    write_stokes(tmp_path / "s.exr", stokes)
    np.testing.assert_array_equal(read_stokes(tmp_path / "s.exr"), stokes)
    np.testing.assert_array_equal(read_exr(tmp_path / "s.exr")["S2.G"], stokes[..., 2, 1])


def test_values_beyond_half_are_kept_as_floats(tmp_path):
    write_exr(tmp_path / "sun.exr", {"Y": np.full((2, 2), 1e5)}, half=True)
    assert read_image(tmp_path / "sun.exr").max() == 1e5


def test_the_same_pixels_give_the_same_bytes(tmp_path):
    for name in "ab":
        write_exr(tmp_path / f"{name}.exr", {"Y": np.arange(12.0).reshape(3, 4)}, half=True)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_masks_and_alpha_survive_png(tmp_path):
    mask = np.eye(6, dtype=bool)
    write_mask(tmp_path / "m.png", mask)
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), mask)
    rgba = np.random.default_rng(1).integers(0, 255, (4, 4, 4), np.uint8)
    write_png(tmp_path / "rgba.png", rgba)
    assert read_image(tmp_path / "rgba.png").shape == (4, 4, 4)


@pytest.mark.parametrize("damage", ["missing", "empty", "truncated", "noise"])
def test_unreadable_images_are_one_line_that_names_the_file(tmp_path, damage):
    path = tmp_path / "image.exr"
    write_exr(path, {"Y": np.random.default_rng(2).normal(size=(64, 64))})
    whole = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"empty": b"", "truncated": whole[: len(whole) // 2], "noise": b"x" * 5000}[damage])
    with pytest.raises(UserError) as caught:
        read_image(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_channel_is_named_with_those_that_are_there(tmp_path):
    write_exr(tmp_path / "a.exr", {"R": np.zeros((2, 2))})
    with pytest.raises(UserError, match=r"S1\.R.*has R"):
        read_image(tmp_path / "a.exr", ["R", "S1.R"])


def test_srgb_encoding_matches_its_inverse():
    x = np.linspace(0, 1, 101, dtype=np.float32)
    np.testing.assert_allclose(srgb_decode(srgb_encode(x)), x, atol=1e-6)


@pytest.mark.parametrize("suffix", ["png", "hdr", "exr"])
def test_a_file_that_the_disk_does_not_take_to_its_end_is_never_taken_for_written(tmp_path, suffix):
    path = tmp_path / f"noise.{suffix}"
    path.symlink_to("/dev/full")
    pixels = np.random.default_rng(0).random((64, 64, 3), np.float32)
    with pytest.raises(UserError, match=path.name):
        (write_png if suffix == "png" else write_rgb)(path, pixels)
