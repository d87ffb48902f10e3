"""Exposures that headers tell: divided out where they differ, never where they do not, and words where they are doubtful."""

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.errors import UserError
from pipeline.formats.images import read_image
from tests.capture.little_captures import ANGLES, behind, codes, dolp, mosaic, raw, stokes
from tests.capture.little_captures import write as write_file


def views(root, exposures, bright=None, suffix="tif", seconds=True):
    """Photographs of one scene; `exposures`: factors stated in the header, `bright`: those that the pixels have."""
    for i, (stated, have) in enumerate(zip(exposures, bright or exposures)):
        header = {"ExposureTime": stated / 100} if seconds and stated else {}
        light = np.repeat(stokes(i)[:, :, 0] * 0.3 * have, 1, 0)
        pixels = light.astype(np.float16) if suffix == "exr" else codes(light)
        write_file(root / "images" / f"{i:03d}.{suffix}", pixels, **header)
    return open_capture(root)


@pytest.mark.parametrize("suffix", ["tif", "png", "exr"])
def test_views_of_different_exposures_are_brought_to_the_usual_one(tmp_path, suffix):
    capture = views(tmp_path, (1, 2, 1, 3, 1, 0.5), suffix=suffix)
    assert not capture.warnings and any("divided out" in fact for fact in capture.facts)
    for i, view in enumerate(capture.views):
        np.testing.assert_allclose(view.read().rgb, stokes(i)[:, :, 0] * 0.3, rtol=3e-3, atol=1e-4)


def test_equal_exposures_change_nothing(tmp_path):
    with_header, without = views(tmp_path / "a", (1, 1, 1)), views(tmp_path / "b", (1, 1, 1), seconds=False)
    assert with_header.warnings == without.warnings == () and with_header.facts == without.facts
    for a, b in zip(with_header.views, without.views):
        assert a.read().rgb.tobytes() == b.read().rgb.tobytes()


def test_thirds_of_a_stop_that_headers_round_are_no_difference(tmp_path):
    capture = views(tmp_path, (1 / 60 * 100, 0.0166 * 100, 0.0167 * 100))
    assert not capture.warnings and not any("exposures" in fact for fact in capture.facts)


@pytest.mark.parametrize("header", [{"Exif:PhotographicSensitivity": (100, 400)}, {"FNumber": (8.0, 4.0)}])
def test_iso_and_aperture_count_like_time(tmp_path, header):
    (name, values), factors = next(iter(header.items())), (1, 4)
    for i in range(4):
        stated = {"ExposureTime": 0.01, "FNumber": 8.0, "Exif__PhotographicSensitivity": 100}
        stated[name.replace(":", "__")] = values[i % 2]
        write_file(tmp_path / "images" / f"{i}.png", codes(stokes(i)[:, :, 0] * 0.2 * factors[i % 2]), **stated)
    capture = open_capture(tmp_path)
    assert not capture.warnings
    levels = [np.median(v.read().rgb / stokes(i)[:, :, 0]) for i, v in enumerate(capture.views)]
    np.testing.assert_allclose(levels, levels[0], rtol=5e-3)


def test_a_stack_of_automatic_exposures_keeps_its_polarisation(tmp_path):
    for i in range(2):
        for k, angle in enumerate(ANGLES):
            e = (1, 1.5, 2, 1.25)[k]
            write_file(
                tmp_path / "images" / f"{i}_{angle:03d}.tif", codes(behind(stokes(i), angle) * 0.4 * e), ExposureTime=e / 100
            )
    capture = open_capture(tmp_path)
    assert not capture.warnings
    for i, view in enumerate(capture.views):
        found = view.read()
        np.testing.assert_allclose(dolp(found.stokes), dolp(stokes(i)), atol=2e-3)
        assert not found.faults


def test_mosaics_of_different_exposures(tmp_path):
    for i, e in enumerate((1, 1, 3)):
        write_file(tmp_path / "images" / f"{i}.png", codes(mosaic(stokes(i)) * 0.3 * e), "Y", ExposureTime=e / 200)
    capture = open_capture(tmp_path)
    assert capture.layout == "mosaic"
    for i, view in enumerate(capture.views):
        inner = view.read().stokes[4:-4, 4:-4, 0, 0] / stokes(i)[4:-4, 4:-4, 0].mean(-1)
        assert np.median(inner) == pytest.approx(0.3, rel=2e-2)


def test_camera_raw_files_are_brought_to_one_exposure(tmp_path):
    (tmp_path / "images").mkdir()
    for i, e in enumerate((1, 2, 3)):
        raw(tmp_path / "images" / f"{i}.dng", 800 * e, 0.01 * e)
    capture = open_capture(tmp_path)
    assert not capture.warnings and any("divided out" in fact for fact in capture.facts)
    assert [float(np.median(v.read().rgb)) for v in capture.views] == pytest.approx([2 * 800 / 3936] * 3, rel=5e-3)


def test_known_exposures_win_and_names_that_fit_nothing_are_refused(tmp_path):
    views(tmp_path, (1, 3))
    (tmp_path / "capture.toml").write_text('[radiometry]\nexposure_s = { "000" = 0.5, "001.tif" = 0.25 }\n')
    capture = open_capture(tmp_path)
    assert not any("divided" in f for f in capture.facts)
    light = [stokes(i)[:, :, 0] * 0.3 * e for i, e in enumerate((1, 3))]
    scales = [float(np.median(v.read().rgb / x)) for x, v in zip(light, capture.views)]
    assert scales == pytest.approx([2, 4], rel=5e-3)
    (tmp_path / "capture.toml").write_text('[radiometry]\nexposure_s = { "000" = 0.5, "oo1" = 0.25 }\n')
    with pytest.raises(UserError, match=r"capture\.toml.*called oo1"):
        open_capture(tmp_path)


def test_pictures_that_contradict_their_headers_are_named(tmp_path):
    capture = views(tmp_path / "a", (1, 1, 4, 4), bright=(1, 1, 1, 1))
    (line,) = capture.warnings
    assert "equally bright" in line and "radiometry.exif_exposure = true" in line
    np.testing.assert_allclose(capture.views[2].read().rgb, stokes(2)[:, :, 0] * 0.3, atol=1e-4)
    (tmp_path / "a" / "capture.toml").write_text("radiometry.exif_exposure = true\n")
    capture = open_capture(tmp_path / "a")
    assert not capture.warnings and np.median(capture.views[2].read().rgb) < 0.05
    (tmp_path / "a" / "capture.toml").write_text("radiometry.exif_exposure = false\n")
    assert not open_capture(tmp_path / "a").warnings


def test_exposures_that_some_files_do_not_tell_are_said_and_not_used(tmp_path):
    capture = views(tmp_path, (1, 3, 0), bright=(1, 3, 2))
    (line,) = capture.warnings
    assert "002.tif" in line and "radiometry.exposure_s" in line
    np.testing.assert_allclose(capture.views[1].read().rgb, stokes(1)[:, :, 0] * 0.9, atol=1e-4)


def two_folders(root, scene, write, seconds, bright):
    """The photographs of two cameras, each folder of one exposure: `seconds` stated, `bright` as the pixels have it."""
    write.two_camera(root, scene)
    for camera, stated, have in zip(("lp0", "lp1"), seconds, bright):
        for path in sorted((root / camera / "images").glob("*.exr")):
            write_exr_with(path, have, stated)
    return open_capture(root)


def write_exr_with(path, factor, seconds):
    pixels = read_image(path) * np.float32(factor)
    path.unlink()
    write_file(path, pixels.astype(np.float16), ExposureTime=seconds)


def test_two_cameras_of_two_folders_are_brought_to_one_exposure(tmp_path, scene, write):
    plain = two_folders(tmp_path / "even", scene, write, (0.01, 0.01), (1, 1))
    capture = two_folders(tmp_path / "other", scene, write, (0.01, 0.04), (1, 4))
    assert not capture.warnings and sum("divided out" in fact for fact in capture.facts) == 1
    for even, other in zip(plain.views, capture.views):
        np.testing.assert_allclose(other.read().rgb, even.read().rgb, rtol=2e-3, atol=1e-4)


def test_two_cameras_that_contradict_their_headers_are_named_once(tmp_path, scene, write):
    capture = two_folders(tmp_path, scene, write, (0.01, 0.04), (1, 1))
    assert sum("equally bright" in line for line in capture.warnings) == 1
