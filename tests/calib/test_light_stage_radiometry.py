"""Light-stage frames heed capture.toml and their headers as all images do, and stay where they are where nothing is to do."""

import json

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.errors import UserError
from pipeline.formats.images import read_image, write_mask
from pipeline.rig.frame_files import frames_root
from stages.calib.decode import frame_samples
from tests.capture.little_captures import codes, raw, write

LIGHTS, SIZE = 6, (16, 20)
CAMERA = (
    "#focal length\n90 90\n#principal point\n10 8\n#resolution\n20 16\n#distortion coeffs\n0 0 0 0\n"
    "MATRIX :\n1 0 0 0\n0 1 0 0\n0 0 1 50\n0 0 0 1\n"
)


def light(k, name):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] / 20
    base = 0.15 + 0.1 * np.sin(2 * x + k) * np.cos(3 * y) + (0.1 if name == "parallel" else 0)
    return (base[..., None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)


def build(root, suffix, make, toml="", stem="{k:06d}", **header):
    """make(linear light, k, pass) -> pixels; header: name -> f(k, pass)."""
    for name in ("cross", "parallel"):
        for k in range(LIGHTS):
            attributes = {key: value(k, name) for key, value in header.items()}
            write(root / f"cam00/{name}/{stem.format(k=k)}.{suffix}", make(light(k, name), k, name), **attributes)
    (root / "cameras").mkdir()
    (root / "cameras/camera00.txt").write_text(CAMERA)
    a = np.arange(LIGHTS)
    rows = "".join(f"{k},{np.cos(t):.4f},{np.sin(t):.4f},1\n" for k, t in zip(a, a))
    (root / "lights.csv").write_text("index,x,y,z\n" + rows)
    write_mask(root / "cam00/mask.png", np.ones(SIZE, bool))
    if toml:
        (root / "capture.toml").write_text(toml)
    return root


def decoded(run_stages, root, tmp_path):
    """(olat.json, frames' folder, what was warned of)."""
    run = run_stages(root, tmp_path / "out", "decode")["decode"]
    index = json.loads((run.output / "olat.json").read_text())
    return index, frames_root(index, root, run.output), run.warnings


def holds(index, folder, scale=1.0, rtol=5e-3):
    for name in ("cross", "parallel"):
        for k, path in enumerate(index["cameras"]["cam00"][name]):
            factor = scale(k, name) if callable(scale) else scale
            want = light(k, name) * factor
            np.testing.assert_allclose(read_image(folder / path, "RGB"), want, rtol=rtol, atol=2e-3 * np.max(factor))


@pytest.mark.parametrize("suffix", ["exr", "tif", "png"])
def test_linear_frames_stay_where_they_are(run_stages, tmp_path, suffix):
    root = build(tmp_path / "c", suffix, lambda x, k, n: x.astype(np.float16) if suffix == "exr" else codes(x))
    index, folder, warnings = decoded(run_stages, root, tmp_path)
    assert folder == root and "frames_in" not in index and not warnings
    assert not (tmp_path / "out/decode/frames").exists()
    holds(index, folder)


def test_some_rows_of_a_large_frame_tell_where_it_is_clipped(run_stages, tmp_path, monkeypatch):
    root = build(tmp_path / "c", "exr", lambda x, k, n: np.minimum(x, 0.3).astype(np.float16))
    whole, _, _ = decoded(run_stages, root, tmp_path)
    for name, value in (("LARGE", 0), ("ROWS", 2), ("EVERY", 4)):
        monkeypatch.setattr(frame_samples, name, value)
    pixels, size = frame_samples.frame_samples(root / "cam00/cross/000000.exr")
    assert pixels.shape[0] < SIZE[0] / 2 and size == SIZE[::-1]
    part, _, warnings = decoded(run_stages, root, tmp_path / "part")
    assert part["saturation_level"] == whole["saturation_level"] == pytest.approx(0.3, rel=1e-3) and not warnings
    assert part["saturated_fraction"] == pytest.approx(whole["saturated_fraction"], rel=0.3)


def test_equal_exposures_in_headers_change_nothing(run_stages, tmp_path):
    root = build(tmp_path / "c", "exr", lambda x, k, n: x.astype(np.float16), ExposureTime=lambda k, n: 0.02)
    index, folder, warnings = decoded(run_stages, root, tmp_path)
    assert folder == root and not warnings and "frames_in" not in index


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp"])
def test_eight_bits_are_srgb_and_that_is_said(run_stages, tmp_path, suffix):
    root = build(tmp_path / "c", suffix, lambda x, k, n: codes(x, 8, srgb=True))
    index, folder, warnings = decoded(run_stages, root, tmp_path)
    assert len(warnings) == 1 and "8 bits a channel, taken as sRGB" in warnings[0]
    holds(index, folder, rtol=0.06)


def test_eight_bits_stated_to_be_linear(run_stages, tmp_path):
    root = build(tmp_path / "c", "png", lambda x, k, n: codes(x, 8), 'radiometry.encoding = "linear"\n')
    _, folder, warnings = decoded(run_stages, root, tmp_path)
    assert folder == root and "taken as linear" in warnings[0]


@pytest.mark.parametrize(
    ("toml", "make", "scale"),
    [
        ("black_level = 1311", lambda x, k, n: codes(x * 0.5 + 0.02), 0.5 / 0.98),
        ("white_level = 4095", lambda x, k, n: codes(x, 12), 1.0),
        ("white_balance = [2.0, 1.0, 0.5]", lambda x, k, n: codes(x), np.array([2.0, 1.0, 0.5])),
        ("exposure_s = { cross = 0.5, parallel = 0.25 }", lambda x, k, n: codes(x), lambda k, n: 2 if n == "cross" else 4),
        ('encoding = "srgb"', lambda x, k, n: codes(x, 16, srgb=True), 1.0),
    ],
)  # fmt: skip
def test_settings_mean_what_they_mean_elsewhere(run_stages, tmp_path, toml, make, scale):
    root = build(tmp_path / "c", "tif", make, f"[radiometry]\n{toml}\n")
    index, folder, warnings = decoded(run_stages, root, tmp_path)
    assert not warnings and index["frames_in"] == "decode"
    holds(index, folder, scale)


def test_dark_frame_and_flat_field(run_stages, tmp_path):
    shade = np.linspace(0.8, 1.2, 20, dtype=np.float32)[None, :, None] * np.ones((*SIZE, 3), np.float32)
    root = build(tmp_path / "c", "tif", lambda x, k, n: codes(x * shade * 0.5 + 0.03),
                 '[radiometry]\ndark_frame = "dark.tif"\nflat_field = "flat.tif"\n')  # fmt: skip
    with pytest.raises(UserError, match=r"capture\.toml: radiometry\.dark_frame = 'dark\.tif' is not there"):
        open_capture(root)
    write(root / "dark.tif", codes(np.full((*SIZE, 3), 0.03)))
    write(root / "flat.tif", codes(shade * 0.5 + 0.03))
    assert {"dark.tif", "flat.tif"} <= {p.name for p in open_capture(root).files}
    index, folder, _ = decoded(run_stages, root, tmp_path)
    holds(index, folder, 0.5, rtol=1e-2)


def test_exposures_of_single_frames_in_headers_are_divided_out(run_stages, tmp_path):
    e = {0: 1.0, 1: 1.0, 2: 2.5, 3: 1.0, 4: 0.5, 5: 1.0}
    root = build(tmp_path / "c", "exr", lambda x, k, n: (x * e[k]).astype(np.float16), ExposureTime=lambda k, n: e[k] / 50)
    index, folder, warnings = decoded(run_stages, root, tmp_path)
    assert not warnings
    holds(index, folder)


def test_a_pass_of_longer_exposure(run_stages, tmp_path):
    root = build(tmp_path / "c", "tif", lambda x, k, n: codes(x * (3 if n == "cross" else 1)),
                 ExposureTime=lambda k, n: 0.3 if n == "cross" else 0.1)  # fmt: skip
    index, folder, _ = decoded(run_stages, root, tmp_path)
    cross, parallel = (read_image(folder / index["cameras"]["cam00"][name][1]).mean() for name in ("cross", "parallel"))
    assert parallel / cross == pytest.approx(light(1, "parallel").mean() / light(1, "cross").mean(), rel=5e-3)


def test_exposures_known_for_some_frames_or_none_are_refused(run_stages, tmp_path):
    root = build(tmp_path / "c", "tif", lambda x, k, n: codes(x), "[radiometry]\nexposure_s = { cross = 0.5 }\n")
    with pytest.raises(UserError, match=r"capture\.toml: radiometry\.exposure_s tells 6 of 12 frames"):
        run_stages(root, tmp_path / "a", "decode")
    (root / "capture.toml").write_text("[radiometry]\nexposure_s = { krosz = 0.5 }\n")
    with pytest.raises(UserError, match=r"capture\.toml: radiometry\.exposure_s: no view or file is called krosz"):
        run_stages(root, tmp_path / "b", "decode")


def test_clipped_codes_are_marked_in_the_numbers_that_are_written(run_stages, tmp_path):
    toml = "radiometry.white_balance = [2, 1, 1.5]\n"
    root = build(tmp_path / "c", "tif", lambda x, k, n: codes(np.clip(x * 5, 0, 1), 12), toml)
    index, folder, warnings = decoded(run_stages, root, tmp_path)
    assert "radiometry.white_level = 4095" in warnings[0]
    level = index["saturation_level"]
    for name in ("cross", "parallel"):
        for k, path in enumerate(index["cameras"]["cam00"][name]):
            pixels = read_image(folder / path, "RGB")
            assert (pixels[light(k, name) * 5 >= 1] >= level).all() and 0.95 <= level <= 1
    assert 0 < index["saturated_fraction"] < 0.8


def test_pixels_that_the_dark_frame_fills_are_left_out(run_stages, tmp_path):
    def hot(x):
        x = x.copy()
        x[5, 7] = 1
        return x

    root = build(tmp_path / "c", "tif", lambda x, k, n: codes(hot(x)), 'radiometry.dark_frame = "dark.tif"\n')
    write(root / "dark.tif", codes(hot(np.zeros((*SIZE, 3)))))
    index, folder, _ = decoded(run_stages, root, tmp_path)
    pixels = read_image(folder / index["cameras"]["cam00"]["cross"][0])
    assert np.isnan(pixels[5, 7]).all() and np.isnan(pixels).sum() == 3 and index["saturation_level"] is None


def test_camera_raw_frames(run_stages, tmp_path):
    root = build(tmp_path / "c", "tif", lambda x, k, n: codes(x))
    for name in ("cross", "parallel"):
        for k in range(LIGHTS):
            (root / f"cam00/{name}/{k:06d}.tif").unlink()
            raw(root / f"cam00/{name}/{k:06d}.dng", 500 + 100 * k + (300 if name == "parallel" else 0), 0.01)
    (root / "cameras/camera00.txt").write_text(CAMERA.replace("20 16", "96 64"))
    write_mask(root / "cam00/mask.png", np.ones((64, 96), bool))
    index, folder, _ = decoded(run_stages, root, tmp_path)
    for k, path in enumerate(index["cameras"]["cam00"]["cross"]):
        assert np.median(read_image(folder / path)) == pytest.approx((500 + 100 * k) / 3936, rel=5e-3)


@pytest.mark.parametrize("stem", ["{k:06d}_ev-2", "{k:06d}_v2", "L{k:03d}_cam1", "f{k:02d}_exp0.5s_v3", "{k:04d}"])
def test_versions_and_exposures_in_names_are_no_frame_numbers(tmp_path, stem):
    root = build(tmp_path / "c", "exr", lambda x, k, n: x.astype(np.float16), stem=stem)
    (camera,) = open_capture(root).light_stage.cameras.values()
    assert [p.stem for p in camera.cross] == [stem.format(k=k) for k in range(LIGHTS)]


def test_brackets_of_a_light_are_refused_and_previews_beside_frames_are_not_frames(tmp_path):
    root = build(tmp_path / "c", "exr", lambda x, k, n: x.astype(np.float16))
    for k in range(LIGHTS):
        write(root / f"cam00/cross/{k:06d}.jpg", codes(light(k, "cross"), 8))
    assert len(open_capture(root).light_stage.cameras["cam00"].cross) == LIGHTS
    other = build(tmp_path / "d", "exr", lambda x, k, n: x.astype(np.float16), stem="{k:06d}_ev0")
    write(other / "cam00/cross/000002_ev-2.exr", light(2, "cross").astype(np.float16))
    with pytest.raises(UserError, match=r"same frame number.*merge exposures"):
        open_capture(other)


def test_a_frame_of_several_images_is_not_read_as_its_first(run_stages, tmp_path):
    root = build(tmp_path / "c", "exr", lambda x, k, n: x.astype(np.float16))
    pixels = light(0, "cross").astype(np.float16)
    both = np.concatenate([pixels, pixels], -1)
    write(root / "cam00/cross/000000.exr", both, "left.R left.G left.B right.R right.G right.B")
    with pytest.raises(UserError, match=r"000000\.exr"):
        run_stages(root, tmp_path / "out", "decode")
