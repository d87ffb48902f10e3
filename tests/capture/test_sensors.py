"""Sensor files to Stokes: mosaics, angle stacks, exposure brackets, camera raw, orientation and levels."""

import numpy as np
import pytest
import tifffile

from pipeline.capture import open_capture
from pipeline.capture.angle_stack.solve import polariser_design, solve_stack
from pipeline.capture.mosaic.demosaic import demosaic
from pipeline.capture.pixels.brackets import merge_exposures
from pipeline.errors import UserError
from pipeline.formats.images import write_exr

ORDER = (90.0, 45.0, 135.0, 0.0)


def textured(size=128):
    """Stokes [H, W, 3, 3] with sharp edges in the light and a polarisation that varies across the picture."""
    y, x = np.mgrid[:size, :size] / size
    rng = np.random.default_rng(1)
    blocks = np.kron(rng.uniform(0.15, 0.9, (11, 11)), np.ones((12, 12)))[:size, :size]
    s0 = blocks[..., None] * np.array([1.0, 0.8, 0.6])
    dolp, aolp = 0.1 + 0.3 * x, np.pi * (0.2 + 0.6 * y)
    ratio = np.stack([np.ones_like(x), dolp * np.cos(2 * aolp), dolp * np.sin(2 * aolp)], -1)
    return (s0[:, :, None] * ratio[..., None]).astype(np.float32)


def as_mosaic(stokes, colour, order=ORDER, bayer="RGGB"):
    y, x = np.mgrid[: stokes.shape[0], : stokes.shape[1]]
    rows = polariser_design(order).reshape(2, 2, 3)[y % 2, x % 2]
    intensity = np.einsum("hwk,hwkc->hwc", rows, stokes)
    if colour == "mono":
        return intensity.mean(-1).astype(np.float32)
    channel = np.array(["RGB".index(c) for c in bayer]).reshape(2, 2)[(y // 2) % 2, (x // 2) % 2]
    return np.take_along_axis(intensity, channel[..., None], -1)[..., 0].astype(np.float32)


def dolp(stokes):
    return np.hypot(stokes[:, :, 1], stokes[:, :, 2]) / stokes[:, :, 0]


@pytest.mark.parametrize(("colour", "least_db"), [("mono", 6), ("bayer", 4)])  # measured 7.3, 4.4
def test_mosaic_carriers_beat_bilinear_in_dolp(colour, least_db):
    truth = textured()
    if colour == "mono":
        truth = np.repeat(truth.mean(-1, keepdims=True), 3, -1)
    mosaic = as_mosaic(truth, colour)
    error = {m: np.mean((dolp(demosaic(mosaic, ORDER, colour, method=m)) - dolp(truth)) ** 2) for m in ("bilinear", "carriers")}
    assert 10 * np.log10(error["bilinear"] / error["carriers"]) > least_db


@pytest.mark.parametrize("bayer", ["RGGB", "GBRG"])
@pytest.mark.parametrize("order", [ORDER, (10.0, 55.0, 145.0, 100.0), (0.0, 45.0, 90.0, 135.0)])
def test_colours_polarised_differently_are_told_apart(bayer, order):
    ratios = np.array([[1, 1, 1], [0.5, 0.1, -0.2], [0.0, -0.3, 0.25]], np.float32)
    stokes = np.tile(ratios * np.float32([0.8, 0.3, 0.1]), (32, 48, 1, 1))
    out = demosaic(as_mosaic(stokes, "bayer", order, bayer), order, "bayer", bayer)
    np.testing.assert_allclose(out, stokes, atol=1e-2)  # measured 5.5e-3; a green's two kinds of neighbours weigh differently


def test_tiles_of_a_mosaic_join_without_seams(monkeypatch):
    from pipeline.capture.mosaic import demosaic as mosaic

    samples = as_mosaic(textured(96), "bayer")
    whole = demosaic(samples, ORDER, "bayer")
    monkeypatch.setattr(mosaic, "ROWS", 32)
    monkeypatch.setattr(mosaic, "COLUMNS", 48)
    np.testing.assert_allclose(demosaic(samples, ORDER, "bayer"), whole, atol=2e-5)


@pytest.mark.parametrize("colour", ["mono", "bayer"])
def test_units_of_a_mosaic_do_not_matter(colour):
    samples = as_mosaic(textured(64), colour)
    whole = demosaic(samples, ORDER, colour)
    for factor in (1e-6, 1e4):
        np.testing.assert_allclose(demosaic(samples * np.float32(factor), ORDER, colour) / factor, whole, atol=1e-5)


def test_black_mosaic_is_black():
    for colour in ("mono", "bayer"):
        out = demosaic(np.zeros((16, 16), np.float32), ORDER, colour)
        assert np.isfinite(out).all() and np.abs(out).max() < 1e-6


@pytest.mark.parametrize("method", ["bilinear", "carriers"])
@pytest.mark.parametrize("order", [ORDER, (0.0, 45.0, 135.0, 90.0), (10.0, 55.0, 145.0, 100.0)])
def test_mosaic_of_even_light_is_exact_for_any_order(method, order):
    stokes = np.tile(np.float32([0.5, 0.12, -0.07])[None, None, :, None], (12, 16, 1, 3))
    out = demosaic(as_mosaic(stokes, "mono", order), order, method=method)
    np.testing.assert_allclose(out, stokes, atol=2e-6)


def test_calibrated_angles_of_a_mosaic_are_demodulated_too():
    truth, order = np.repeat(textured().mean(-1, keepdims=True), 3, -1), (89.2, 45.6, 134.7, 0.5)
    found = demosaic(as_mosaic(truth, "mono", order), order)
    plain = demosaic(as_mosaic(truth, "mono", order), order, method="bilinear")
    assert np.mean((dolp(found) - dolp(truth)) ** 2) < 0.2 * np.mean((dolp(plain) - dolp(truth)) ** 2)


def test_mosaic_folder_is_recognised_and_read(tmp_path):
    truth = np.repeat(textured(64).mean(-1, keepdims=True), 3, -1)
    (tmp_path / "images").mkdir()
    for i in range(2):
        codes = np.round(as_mosaic(truth, "mono") * 65535).astype(np.uint16)
        tifffile.imwrite(tmp_path / "images" / f"{i}.tif", codes, photometric="minisblack")
    capture = open_capture(tmp_path)
    assert capture.layout == "mosaic" and capture.polarisation == "stokes"
    view = capture.views[0].read()
    flat = np.abs(np.diff(truth[:, :, 0, 0], axis=1, prepend=0)) < 1e-6
    assert np.median(np.abs(view.stokes - truth)[flat]) < 1e-2  # measured 6e-3
    assert view.design.shape == (4, 3)


def test_grey_photographs_are_no_mosaic(tmp_path):
    (tmp_path / "images").mkdir()
    grey = textured(64)[:, :, 0, 1] + np.random.default_rng(0).normal(0, 0.01, (64, 64))
    tifffile.imwrite(
        tmp_path / "images" / "a.tif", np.round(np.clip(grey, 0, 1) * 65535).astype(np.uint16), photometric="minisblack"
    )
    assert open_capture(tmp_path).layout == "photographs"


@pytest.mark.parametrize("angles", [(0, 45, 90), (0, 60, 120), (3, 50, 88, 137), (10, 40, 70, 100, 130, 160)])
def test_stack_of_any_angles_gives_the_stokes_vector_back(angles):
    truth = textured(32)
    design = polariser_design(angles, extinction=200.0)
    samples = np.einsum("nk,hwkc->nhwc", design, truth).astype(np.float32)
    stokes, lost = solve_stack(samples, design)
    np.testing.assert_allclose(stokes, truth, atol=3e-6)
    assert lost is None


def test_saturated_angles_are_left_out_and_too_few_are_marked():
    truth = textured(16)
    design = polariser_design((0, 45, 90, 135))
    samples = np.einsum("nk,hwkc->nhwc", design, truth).astype(np.float32)
    usable = np.ones(samples.shape[:3], bool)
    samples[1, 3, 4], usable[1, 3, 4] = 9.0, False
    samples[:2, 5, 5], usable[:2, 5, 5] = 9.0, False
    stokes, lost = solve_stack(samples, design, usable)
    np.testing.assert_allclose(stokes[3, 4], truth[3, 4], atol=1e-5)
    assert lost[5, 5] and lost.sum() == 1


def test_turntable_positions_are_no_polariser_angles(tmp_path):
    rgb = textured(16)[:, :, 0]
    for angle in range(0, 360, 30):
        write_exr(tmp_path / "images" / f"cup_{angle:03d}.exr", {c: rgb[..., i] for i, c in enumerate("RGB")})
    capture = open_capture(tmp_path)
    assert capture.layout == "photographs" and len(capture.views) == 12


def test_clockwise_dial_with_its_own_zero(scene, tmp_path):
    for name in scene.names:
        for dial in (0, 50, 100, 150):
            rgb = scene.intensity(name, 30 - dial)
            write_exr(tmp_path / "images" / f"{name}_{dial:03d}.exr", {c: rgb[..., i] for i, c in enumerate("RGB")})
    (tmp_path / "capture.toml").write_text("[stack]\nclockwise = true\nzero_deg = 30\n")
    view = open_capture(tmp_path).views[1]
    np.testing.assert_allclose(view.read().stokes, scene.stokes[view.view], atol=2e-6)


def test_bracket_merge_uses_unsaturated_samples_and_weighs_by_noise():
    truth = np.linspace(0.001, 3.0, 64, dtype=np.float32).reshape(8, 8, 1)
    rng = np.random.default_rng(0)
    seconds, images, clipped = [0.1, 1.0, 10.0], [], []
    for t in seconds:
        raw = truth * t + rng.normal(0, 1e-3, truth.shape)
        clipped.append(raw[..., 0] > 0.98)
        images.append(np.minimum(raw, 1.0).astype(np.float32))
    merged, lost = merge_exposures(images, clipped, seconds)
    assert not lost.any()
    assert np.median(np.abs(merged - truth) / truth) < 0.01


def test_bracketed_files_become_one_view(tmp_path):
    truth = textured(16)[:, :, 0]
    for stops in (-2, 0, 1):
        codes = np.round(np.minimum(truth * 2.0**stops, 1) * 65535).astype(np.uint16)
        (tmp_path / "images").mkdir(exist_ok=True)
        tifffile.imwrite(tmp_path / "images" / f"a_ev{stops:+d}.tif", codes, photometric="rgb")
    view = open_capture(tmp_path).views[0]
    assert view.view == "a" and len(view.paths) == 3
    np.testing.assert_allclose(view.read().rgb, truth, rtol=2e-3)


def dng(path, codes, black=64, white=4000):
    """A minimal Bayer DNG (RGGB) of 16-bit codes [H, W]."""
    matrix = [1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1]
    tags = [(50706, "B", 4, (1, 4, 0, 0)), (271, "s", 0, "Test"), (272, "s", 0, "Camera"), (50708, "s", 0, "Test Camera"),
            (33421, "H", 2, (2, 2)), (33422, "B", 4, (0, 1, 1, 2)), (50714, "H", 1, black), (50717, "H", 1, white),
            (50721, "2i", 9, tuple(matrix)), (50728, "2I", 3, (1, 1, 1, 1, 1, 1))]  # fmt: skip
    tifffile.imwrite(path, codes, photometric="CFA", compression=None, metadata=None, software=None, extratags=tags)


def test_dng_comes_back_within_one_code_value(tmp_path):
    rng = np.random.default_rng(0)
    colours = rng.integers(200, 3900, 3)
    y, x = np.mgrid[:64, :96]
    channel = np.array([[0, 1], [1, 2]])[y % 2, x % 2]
    (tmp_path / "images").mkdir()
    dng(tmp_path / "images" / "flat.dng", colours[channel].astype(np.uint16))
    textured_codes = np.where(x < 48, 500, 3000).astype(np.uint16)
    dng(tmp_path / "images" / "edge.dng", textured_codes)
    capture = open_capture(tmp_path)
    assert [v.view for v in capture.views] == ["edge", "flat"] and capture.views[0].size == (96, 64)
    flat = capture.view("flat").read().rgb * (4000 - 64)
    assert np.abs(flat - (colours - 64)).max() <= 1
    edge = capture.view("edge").read().rgb * (4000 - 64)
    assert np.abs(edge[:, :44] - 436).max() <= 1 and np.abs(edge[:, 52:] - 2936).max() <= 1


def test_truncated_and_foreign_raw_are_named(tmp_path):
    (tmp_path / "images").mkdir()
    dng(tmp_path / "images" / "a.dng", np.full((64, 64), 900, np.uint16))
    data = (tmp_path / "images" / "a.dng").read_bytes()
    (tmp_path / "images" / "a.dng").write_bytes(data[: len(data) // 2])
    with pytest.raises(UserError, match=r"a\.dng.*truncated|a\.dng.*corrupt"):
        open_capture(tmp_path).views[0].read()
    (tmp_path / "images" / "a.dng").write_bytes(b"not a raw file at all" * 10)
    with pytest.raises(UserError, match=r"a\.dng"):
        open_capture(tmp_path)
    (tmp_path / "images" / "a.dng").unlink()
    (tmp_path / "images" / "clip.R3D").write_bytes(b"RED2")
    with pytest.raises(UserError, match=r"clip\.R3D.*EXR"):
        open_capture(tmp_path)


def test_levels_and_dark_frame_and_flat_field(tmp_path):
    (tmp_path / "images").mkdir()
    truth = textured(16)[:, :, 0]
    shade = np.linspace(0.7, 1.3, 16, dtype=np.float32)[None, :, None] * np.ones((16, 1, 3), np.float32)
    dark = np.full((16, 16, 3), 100, np.uint16)
    codes = np.round(100 + truth * shade / 1.3 * 3900).astype(np.uint16)
    tifffile.imwrite(tmp_path / "images" / "a.tif", codes, photometric="rgb")
    tifffile.imwrite(tmp_path / "dark.tif", dark, photometric="rgb")
    tifffile.imwrite(tmp_path / "flat.tif", np.round(100 + shade * 2000).astype(np.uint16), photometric="rgb")
    (tmp_path / "capture.toml").write_text(
        '[radiometry]\nwhite_level = 3900\ndark_frame = "dark.tif"\nflat_field = "flat.tif"\n'
    )
    rgb = open_capture(tmp_path).views[0].read().rgb
    np.testing.assert_allclose(rgb, truth / 1.3, rtol=5e-3)


def shifted(image, x, y, degrees=0.0):
    """The picture moved to the right and down by a fraction of a pixel, and turned about its centre."""
    from scipy.ndimage import affine_transform

    turn, centre = np.radians(degrees), (np.array(image.shape[:2]) - 1) / 2
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    offset = centre - matrix @ (centre + np.array([y, x]))
    return np.stack([affine_transform(plane, matrix, offset, order=3, mode="nearest") for plane in np.moveaxis(image, 2, 0)], 2)


def stack_of(root, truth, angles=(0, 45, 90, 135), names=None, move=None):
    for k, angle in enumerate(angles):
        image = np.einsum("k,hwkc->hwc", polariser_design([angle])[0], truth)
        image = shifted(image, *move) if move and k == 2 else image
        for view in "ab":
            name = f"{view}_{(names or angles)[k]:03d}.exr"
            write_exr(root / "images" / name, {c: image[..., i].astype(np.float32) for i, c in enumerate("RGB")})


@pytest.mark.parametrize(("move", "furthest"), [((1.6, -0.7), np.hypot(1.6, 0.7)), ((1.2, 0.5, 1.5), 3.6)])
def test_movement_between_the_angles_is_measured_and_taken_out_where_asked(tmp_path, move, furthest):
    from scipy.ndimage import gaussian_filter

    truth = np.stack([gaussian_filter(p, (1.2, 1.2, 0)) for p in np.moveaxis(textured(), 2, 0)], 2).astype(np.float32)
    stack_of(tmp_path / "still", truth)
    assert open_capture(tmp_path / "still").views[0].read().moved is None
    stack_of(tmp_path / "moved", truth, move=move)
    view = open_capture(tmp_path / "moved").views[0].read()
    assert view.moved[1].name == "a_090.exr" and view.moved[0] == pytest.approx(furthest, abs=0.3)
    (tmp_path / "moved" / "capture.toml").write_text("[stack]\nalign = true\n")
    aligned = open_capture(tmp_path / "moved").views[0].read()
    inner = (slice(6, -6), slice(6, -6))
    before, after = (np.sqrt(((dolp(v.stokes) - dolp(truth))[inner] ** 2).mean()) for v in (view, aligned))
    assert aligned.moved is None and after < 0.3 * before


def test_swapped_angles_of_a_stack_are_suspected(tmp_path):
    stack_of(tmp_path / "right", textured())
    assert not open_capture(tmp_path / "right").views[0].read().faults
    stack_of(tmp_path / "swapped", textured(), names=(0, 90, 45, 135))
    (fault,) = open_capture(tmp_path / "swapped").views[0].read().faults
    assert "no Stokes vector explains all angles" in fault


@pytest.mark.parametrize("colour", ["mono", "bayer"])
def test_wrong_mosaic_order_is_suspected(tmp_path, colour):
    codes = np.round(as_mosaic(textured(), colour) * 65535).astype(np.uint16)
    (tmp_path / "images").mkdir()
    tifffile.imwrite(tmp_path / "images" / "a.tif", codes, photometric="minisblack")
    toml = f'layout = "mosaic"\n[mosaic]\ncolour = "{colour}"\n'
    for order, suspected in (("90, 45, 135, 0", None), ("0, 90, 45, 135", "diagonally"), ("0, 45, 90, 135", "diagonally")):
        (tmp_path / "capture.toml").write_text(f"{toml}order = [{order}]\n")
        faults = [f for f in open_capture(tmp_path).views[0].read().faults if "crossed" in f]
        assert bool(faults) == bool(suspected) and all(suspected in f for f in faults)
