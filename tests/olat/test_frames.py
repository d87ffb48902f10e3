"""Bands, reading and misregistration: what reaches the fits is what is in the files."""

import time
import weakref

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.images import write_exr
from stages.olat.parameters import OlatParameters, every
from stages.olat.reading.frame_reader import Samples, ahead, read_bands, read_rows
from stages.olat.reading.misregistration import Misregistration, measure
from stages.olat.reading.scanline_bands import Band, bands_of


def test_bands_cover_the_mask_once_in_whole_chunks():
    mask = np.zeros((100, 8), bool)
    mask[5:40, 2:6] = True
    mask[70:99, 1:3] = True
    bands = bands_of(mask, lights=100, band_mb=0.05, itemsize=2)
    assert np.array_equal(np.concatenate([b.pixels for b in bands]), np.flatnonzero(mask))
    assert all(b.top % 16 == 0 for b in bands) and len(bands) > 2


def test_bands_end_with_the_object_and_hold_no_rows_far_above_or_below_it():
    mask = np.zeros((4000, 8), bool)
    mask[1000:1020] = True
    for band_mb in (1e-3, 1e3):
        bands = bands_of(mask, lights=100, band_mb=band_mb, itemsize=2)
        assert bands[0].top == 992 and bands[-1].bottom == 1024
    assert bands_of(np.zeros((40, 8), bool), lights=100, band_mb=1.0, itemsize=2) == []


def test_a_band_is_never_larger_than_asked_unless_it_is_one_chunk():
    bands = bands_of(np.ones((160, 50), bool), lights=10, band_mb=0.2, itemsize=2)
    assert all(len(b.pixels) * 10 * 6 * 2 <= 0.2 * 2**20 or b.bottom - b.top == 16 for b in bands)


@pytest.mark.parametrize("half", [True, False])
def test_samples_are_the_files_pixels_in_the_order_of_the_lights(tmp_path, half):
    rng = np.random.default_rng(0)
    frames, paths = [], []
    for k in range(6):
        image = rng.uniform(0, 2, (40, 9, 3)).astype(np.float16).astype(np.float32)
        write_exr(tmp_path / f"{k}.exr", {c: image[..., i] for i, c in enumerate("RGB")}, half=half)
        frames.append(image)
        paths.append(tmp_path / f"{k}.exr")
    mask = rng.uniform(size=(40, 9)) > 0.4
    bands = bands_of(mask, 3, 1e-3, 2 if half else 4)
    for samples in read_bands(paths[:3], paths[3:], bands, (9, 40), half):
        for k in range(3):
            for data, frame in ((samples.cross[k], frames[k]), (samples.parallel[k], frames[3 + k])):
                values = data.view(np.float16).astype(np.float32) if half else data
                assert np.array_equal(values, frame.reshape(-1, 3)[samples.band.pixels])


def test_reading_ahead_holds_two_bands_at_most():
    alive: list[weakref.ref] = []

    class Item:
        pass

    def items():
        for _ in range(6):
            item = Item()
            alive.append(weakref.ref(item))
            yield item
            del item

    seen = 0
    for item in ahead(items()):
        seen += 1
        deadline = time.monotonic() + 5
        while len(alive) < min(seen + 1, 6) and time.monotonic() < deadline:
            time.sleep(0.001)
        assert sum(reference() is not None for reference in alive) <= 2 and len(alive) <= seen + 1
        del item
    assert seen == 6


def test_a_fault_while_reading_ahead_reaches_the_caller():
    def items():
        yield 1
        raise UserError("frame", "is broken", "mend it")

    made = ahead(items())
    assert next(made) == 1
    with pytest.raises(UserError, match="is broken"):
        next(made)


def test_a_truncated_frame_is_named(tmp_path):
    path = tmp_path / "000001.exr"
    write_exr(path, {c: np.random.default_rng(0).uniform(size=(64, 64)) for c in "RGB"}, half=True)
    path.write_bytes(path.read_bytes()[:4000])
    with pytest.raises(UserError, match=r"000001\.exr"):
        read_rows(path, 48, 64, 64, 64, True)


def shifted(right: int, down: int) -> Misregistration:
    rng = np.random.default_rng(1)
    blobs = sum(np.exp(-((np.mgrid[:64, :48] - rng.uniform(8, 40, (2, 1, 1))) ** 2).sum(0) / 12) for _ in range(20)) + 0.05
    images = [blobs, np.roll(blobs, (down, right), (0, 1))]
    band = Band(0, 64, np.arange(64 * 48))
    misregistration = Misregistration(48, 64)
    cross, parallel = (np.repeat(i.reshape(1, -1, 1), 3, 2).astype(np.float32) for i in images)
    misregistration.add(Samples(band, cross, parallel))
    return misregistration


@pytest.mark.parametrize("move", [(0, 0), (3, 0), (0, -2), (-4, 5)])
def test_misregistration_of_the_passes_is_measured(move):
    assert np.allclose(shifted(*move).shift(), move, atol=0.2)


def test_light_selections_without_meaning_are_refused():
    assert every("all") == 1 and every("every=4") == 4
    for bad in ("every=0", "half", "every=x"):
        with pytest.raises(ValueError, match="every=k"):
            OlatParameters(lights=bad)


def test_a_shifted_parallel_pass_is_found_and_read_back_into_place(tmp_path):
    rng = np.random.default_rng(3)
    height, width, right, down = 80, 64, 3, -5
    grid = np.mgrid[:height, :width]
    blobs = sum(np.exp(-((grid - rng.uniform(15, 50, (2, 1, 1))) ** 2).sum(0) / 12) for _ in range(25)) + 0.05
    paths: dict[str, list] = {"cross": [], "parallel": []}
    for k in range(8):
        image = (blobs * (1 + 0.1 * k)).astype(np.float16).astype(np.float32)
        for name, moved in (("cross", image), ("parallel", np.roll(image, (down, right), (0, 1)))):
            path = tmp_path / name / f"{k:06d}.exr"
            write_exr(path, dict.fromkeys("RGB", moved), half=True)
            paths[name].append(path)
    mask = np.zeros((height, width), bool)
    mask[8:72, 6:58] = True
    found = measure(paths["cross"], paths["parallel"], mask, True, 1.0).shift()
    assert np.allclose(found, (right, down), atol=0.3)
    bands = bands_of(mask, 8, 0.02, 2)
    for samples in read_bands(paths["cross"], paths["parallel"], bands, (width, height), True, shift=(right, down)):
        assert np.array_equal(samples.cross, samples.parallel)
