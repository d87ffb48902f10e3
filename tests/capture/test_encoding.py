"""Linear light or sRGB: decided by four angles where they determine it, and by a degree of polarisation of at most one."""

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.capture.angle_stack.solve import polariser_design
from pipeline.capture.radiometry.encoding import find_encoding, mosaic_codes
from pipeline.formats.images import srgb_encode
from tests.capture.little_captures import ANGLES, ORDER, behind, codes, dolp, mosaic, stokes, write


def stack(root, srgb, bits=8, angles=ANGLES, strength=0.5, noise=0.0, most=1.0):
    rng = np.random.default_rng(0)
    for i in range(3):
        light = stokes(i, strength) * most
        for angle in angles:
            image = behind(light, angle)
            image = np.clip(image + rng.normal(0, noise, image.shape), 0, 1)
            write(root / "images" / f"{i}_{angle:03d}.png", codes(image, bits, srgb))
    return open_capture(root)


def median_error(capture, strength, most=1.0):
    return max(float(np.median(np.abs(dolp(v.read().stokes) - dolp(stokes(i, strength))))) for i, v in enumerate(capture.views))


@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_linear_stacks_of_eight_bits_are_read_as_linear(tmp_path, noise):
    capture = stack(tmp_path, srgb=False, noise=noise)
    (line,) = capture.warnings
    assert 'radiometry.encoding = "linear"' in line
    assert median_error(capture, 0.5) < 0.01 + 4 * noise


@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_srgb_stacks_of_eight_bits_stay_srgb_without_a_new_word(tmp_path, noise):
    capture = stack(tmp_path, srgb=True, noise=noise)
    assert capture.warnings == () and median_error(capture, 0.5) < 0.01 + 4 * noise
    assert [f for f in capture.views[0].read().faults if "taken as sRGB" in f]


def test_sixteen_bit_stacks_are_tested_too(tmp_path):
    assert stack(tmp_path / "linear", srgb=False, bits=16).warnings == ()
    capture = stack(tmp_path / "srgb", srgb=True, bits=16)
    assert 'radiometry.encoding = "srgb"' in capture.warnings[0] and median_error(capture, 0.5) < 0.01


def test_what_is_specified_is_not_tested(tmp_path):
    stack(tmp_path, srgb=False)
    (tmp_path / "capture.toml").write_text('radiometry.encoding = "srgb"\n')
    assert open_capture(tmp_path).warnings == ()


def test_hardly_polarised_stacks_keep_the_usual_reading(tmp_path):
    assert stack(tmp_path, srgb=False, strength=0.02, noise=0.01).warnings == ()


def test_three_angles_tell_linear_light_where_srgb_would_be_impossible(tmp_path):
    capture = stack(tmp_path / "linear", srgb=False, angles=(0, 60, 120), strength=0.95)
    assert 'radiometry.encoding = "linear"' in capture.warnings[0]
    assert stack(tmp_path / "srgb", srgb=True, angles=(0, 60, 120), strength=0.95).warnings == ()


def test_exposures_that_differ_within_a_stack_do_not_mislead_the_test(tmp_path):
    for i in range(2):
        for k, angle in enumerate(ANGLES):
            e = (1, 1.5, 2, 1.25)[k]
            image = codes(behind(stokes(i, 0.6), angle) * 0.5 * e, 8)
            write(tmp_path / "images" / f"{i}_{angle:03d}.png", image, ExposureTime=e / 100)
    capture = open_capture(tmp_path)
    assert 'radiometry.encoding = "linear"' in capture.warnings[0] and median_error(capture, 0.6) < 0.01


def mosaics(root, srgb, strength=0.7, count=2):
    for i in range(count):
        write(root / "images" / f"{i}.png", codes(mosaic(stokes(i, strength, 96)), 8, srgb), "Y")
    return open_capture(root)


def test_mosaics_of_eight_bits_are_tested(tmp_path):
    assert mosaics(tmp_path / "linear", srgb=False).warnings == ()
    capture = mosaics(tmp_path / "srgb", srgb=True)
    (line,) = capture.warnings
    assert 'radiometry.encoding = "srgb"' in line and capture.layout == "mosaic"
    found = dolp(capture.views[0].read().stokes)[8:-8, 8:-8]
    assert np.median(np.abs(found - dolp(stokes(0, 0.7, 96))[8:-8, 8:-8])) < 0.02


def test_files_that_are_encoded_unlike_the_others_are_told_apart(tmp_path):
    mosaics(tmp_path, srgb=False)
    write(tmp_path / "images" / "odd.png", codes(mosaic(stokes(3, 0.7, 96)), 8, srgb=True), "Y")
    capture = open_capture(tmp_path)
    (line,) = capture.warnings
    assert "odd.png" in line and "1 of these files" in line
    kinds = [next(f for f in v.read().faults if "8 bits" in f) for v in capture.views]
    assert ["sRGB" in k for k in kinds] == [False, False, True]


@pytest.mark.parametrize("bayer", [False, True])
@pytest.mark.parametrize("srgb", [False, True])
def test_the_share_of_the_predicted_misfit_is_zero_or_one(bayer, srgb):
    light = stokes(0, 0.7, 128)
    if bayer:
        y, x = np.mgrid[:128, :128]
        design = polariser_design(ORDER).reshape(2, 2, 3)[y % 2, x % 2]
        values = np.einsum("hwk,hwkc->hwc", design, light)
        image = np.take_along_axis(values, np.array([[0, 1], [1, 2]])[(y // 2) % 2, (x // 2) % 2][..., None], -1)[..., 0]
    else:
        image = mosaic(light)
    finding = find_encoding(mosaic_codes(codes(image, 8, srgb) / np.float32(255), bayer), polariser_design(ORDER))
    assert finding.share == pytest.approx(float(srgb), abs=0.15) and finding.encoding == ("srgb" if srgb else "linear")


def test_noise_alone_decides_nothing():
    rng = np.random.default_rng(3)
    design = polariser_design(ANGLES)
    decided = [
        find_encoding(np.clip(rng.normal(level, 0.05, (4, 4000)), 0, 1).astype(np.float32), design)
        for level in (0.2, 0.3, 0.5, 0.7)
    ]
    assert all(f is None or f.encoding is None or abs(f.share - 0.5) > 4 * f.error for f in decided)
    assert sum(f is not None and f.encoding == "srgb" for f in decided) == 0


def test_a_single_place_decides_nothing():
    """All misfit in one place agrees with itself: its error seems to be nought. Many places do decide."""
    design = polariser_design((0, 45, 90, 135))
    stokes = np.repeat([[0.5], [0.0], [0.0]], 200, axis=1)
    for chosen, found in ((slice(50, 51), None), (slice(0, 200), "srgb")):
        stokes[1, chosen], stokes[2, chosen] = 0.4, 0.1
        codes = srgb_encode((design @ stokes).clip(0, 1)).astype(np.float32)
        finding = find_encoding(codes, design)
        assert (finding.encoding if finding is not None else None) == found
