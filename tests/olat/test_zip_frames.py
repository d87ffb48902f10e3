"""Frames read without OpenImageIO hold the same samples; whatever is no whole zip file of this size is left to it, or named."""

import numpy as np
import OpenImageIO as oiio
import pytest

from pipeline.errors import UserError
from pipeline.formats.images import write_exr
from stages.olat.reading import zip_frames
from stages.olat.reading.frame_reader import read_bands, read_rows
from stages.olat.reading.scanline_bands import bands_of

HEIGHT, WIDTH = 50, 13


def image(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 4, (HEIGHT, WIDTH, 3)).astype(np.float16).astype(np.float32)


def write(path, pixels, compression="zip", kind="half", names=("R", "G", "B")):
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], len(names), kind)
    spec.channelnames = names
    spec.attribute("compression", compression)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(np.ascontiguousarray(pixels)) and out.close()


def read(path, half=True, rows=HEIGHT):
    mask = np.zeros((rows, WIDTH), bool)
    mask[5:7], mask[20, 3], mask[-9:, 2:9] = True, True, True
    (samples,) = read_bands([path], [path], bands_of(mask, 1, 9.0, 2), (WIDTH, rows), half)
    values = samples.cross.view(np.float16) if half else samples.cross
    return values[0].astype(np.float32), mask


@pytest.mark.parametrize("together", [1, 3000, 1 << 22])
@pytest.mark.parametrize(("compression", "kind"), [("zip", "half"), ("zips", "half"), ("zip", "float"), ("piz", "half")])
def test_samples_are_the_files_whatever_its_compression(tmp_path, monkeypatch, together, compression, kind):
    monkeypatch.setattr(zip_frames, "TOGETHER", together)  # chunks inflated at a time
    write(tmp_path / "a.exr", image(), compression, kind)
    values, mask = read(tmp_path / "a.exr", kind == "half")
    assert np.array_equal(values, image()[mask])


def test_chunks_that_zip_would_enlarge_and_flat_ones_are_read(tmp_path):
    noise = np.random.default_rng(1).integers(0, 0x7C00, (HEIGHT, WIDTH, 3), np.uint16).view(np.float16)
    for name, pixels in (("noise", noise.astype(np.float32)), ("flat", np.full((HEIGHT, WIDTH, 3), 0.25, np.float32))):
        write(tmp_path / f"{name}.exr", pixels)
        values, mask = read(tmp_path / f"{name}.exr")
        assert np.array_equal(values, pixels[mask])


def test_other_channels_and_grey_frames_are_read_by_name(tmp_path):
    five = np.concatenate([image(), image(1)[..., :2]], -1)
    write(tmp_path / "five.exr", five, names=("R", "G", "B", "A", "depth"))
    write(tmp_path / "grey.exr", image()[..., 1:2], names=("Y",))
    values, mask = read(tmp_path / "five.exr")
    assert np.array_equal(values, image()[mask])
    assert np.array_equal(read(tmp_path / "grey.exr")[0], np.repeat(image()[mask][:, 1:2], 3, 1))


def test_zip_frames_do_not_go_through_openimageio(tmp_path, monkeypatch):
    monkeypatch.setattr("stages.olat.reading.frame_reader.read_rows", lambda *a: pytest.fail("read the slow way"))
    write_exr(tmp_path / "a.exr", {c: image()[..., k] for k, c in enumerate("RGB")}, half=True)
    read(tmp_path / "a.exr")


@pytest.mark.parametrize("cut", [300, 1500])
def test_a_damaged_frame_is_named(tmp_path, cut):
    write(tmp_path / "000007.exr", image())
    whole = (tmp_path / "000007.exr").read_bytes()
    (tmp_path / "000007.exr").write_bytes(whole[:-cut])
    with pytest.raises(UserError, match=r"000007\.exr: .*truncated or corrupt|000007\.exr: cannot be read"):
        read(tmp_path / "000007.exr")


def test_a_frame_of_another_size_is_named(tmp_path):
    write(tmp_path / "000003.exr", image())
    with pytest.raises(UserError, match=r"000003\.exr: is 13x50, this camera's other frames 13x60"):
        read(tmp_path / "000003.exr", rows=60)
    with pytest.raises(UserError, match="is 13x50"):
        read_rows(tmp_path / "000003.exr", 0, 16, 12, 50, True)
