"""capture.toml's radiometry holds for light whatever the file is, and for nothing but light."""

import numpy as np
import pytest

from pipeline.capture import open_capture
from tests.capture.little_captures import ANGLES, SIDE, behind, codes, mosaic, raw, stokes, write


def coloured(root, name, level=1.0):
    alpha = np.zeros((SIDE, SIDE, 1), np.uint16)
    alpha[8:40, 8:40] = 65535
    write(root / "images" / name, np.concatenate([codes(level * stokes(0)[:, :, 0]), alpha], -1), "R G B A")


def test_an_exposure_does_not_divide_the_mask_in_alpha(tmp_path):
    coloured(tmp_path / "one", "a.png")
    coloured(tmp_path / "one", "b.png")
    (tmp_path / "one/capture.toml").write_text("radiometry.exposure_s = { a = 4.0, b = 0.01 }\n")
    for view, seconds in zip(open_capture(tmp_path / "one").views, (4.0, 0.01)):
        found = view.read()
        assert set(np.unique(found.alpha)) == {0, 1}
        np.testing.assert_allclose(found.rgb * seconds, stokes(0)[:, :, 0], atol=1e-4)
    for seconds in (1, 4):
        coloured(tmp_path / "bracket", f"a_exp{seconds}.png", seconds / 8)
    found = open_capture(tmp_path / "bracket").views[0].read()
    assert set(np.unique(found.alpha)) == {0, 1}
    np.testing.assert_allclose(found.rgb, stokes(0)[:, :, 0] / 8, atol=1e-3)


@pytest.mark.parametrize("kind", ["mosaic", "linear stack", "srgb stack"])
def test_a_dark_frame_of_eight_bits_is_read_as_the_pictures_are(tmp_path, kind):
    srgb, offset = kind == "srgb stack", 0.2
    dark = np.full((SIDE, SIDE, 1 if kind == "mosaic" else 3), offset, np.float32)
    for i in range(2):
        light = 0.7 * stokes(i, 0.5)
        if kind == "mosaic":
            write(tmp_path / f"images/{i}.png", codes(mosaic(light) + offset, 8), "Y")
        else:
            for angle in ANGLES:
                write(tmp_path / f"images/{i}_{angle:03d}.png", codes(behind(light, angle) + offset, 8, srgb))
    write(tmp_path / "dark.png", codes(dark, 8, srgb))
    (tmp_path / "capture.toml").write_text('radiometry.dark_frame = "dark.png"\n')
    found = open_capture(tmp_path).views[0].read().stokes[8:-8, 8:-8, 0].mean(-1)
    np.testing.assert_allclose(np.median(found / (0.7 * stokes(0)[8:-8, 8:-8, 0].mean(-1))), 1, atol=0.04)


def test_exposures_and_dark_frames_hold_for_mosaics_of_camera_raw(tmp_path):
    (tmp_path / "images").mkdir()
    for name, level in (("a", 1000), ("b", 2000)):
        raw(tmp_path / f"images/{name}.dng", level, 1)
    raw(tmp_path / "dark.dng", 500, 1)
    settings = 'dark_frame = "dark.dng"\nexposure_s = { a = 1.0, b = 3.0 }\n'
    (tmp_path / "capture.toml").write_text(f'layout = "mosaic"\nmosaic.colour = "mono"\n[radiometry]\n{settings}')
    first, second = (np.median(view.read().stokes[:, :, 0]) for view in open_capture(tmp_path).views)
    assert first == pytest.approx(2 * 500 / (4000 - 64), rel=1e-3) and second == pytest.approx(first, rel=1e-3)


def test_white_balance_and_exposure_hold_for_pandoras_files(tmp_path, scene, write):
    write.pandora(tmp_path, scene)
    settings = f'white_balance = [2, 1, 0.5]\nexposure_s = {{ "{scene.names[0]}" = 4.0 }}\n'
    (tmp_path / "capture.toml").write_text(f"[radiometry]\n{settings}")
    for view in open_capture(tmp_path).views:
        wanted = scene.stokes[view.view] * [2, 1, 0.5] / (4 if view.view == scene.names[0] else 1)
        np.testing.assert_allclose(view.read().stokes, wanted, rtol=0.05, atol=0.02)
