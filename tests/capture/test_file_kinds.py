"""Files of industrial cameras and files of several images: read by what they hold, or refused in one line."""

import numpy as np
import pytest
import tifffile

from pipeline.capture import open_capture
from pipeline.errors import UserError
from pipeline.formats.bare_arrays import unpacked
from tests.capture.little_captures import ANGLES, SIDE, behind, codes, dolp, mosaic, stokes, write, write_parts


def is_mosaic_of(root, rel=0.02, layout="mosaic"):
    capture = open_capture(root)
    assert capture.layout == layout and capture.polarisation == "stokes" and capture.warnings == ()
    for i, view in enumerate(capture.views):
        found = view.read().stokes[4:-4, 4:-4, 0, 0] / stokes(i)[4:-4, 4:-4, 0].mean(-1)
        assert np.median(found) == pytest.approx(1, rel=rel)
    return capture


def is_stack_of(capture, atol=3e-3, grey=False):
    assert capture.polarisation == "stokes" and capture.warnings == () and capture.masks is None
    for i, view in enumerate(capture.views):
        truth = np.repeat(stokes(i).mean(-1, keepdims=True), 3, -1) if grey else stokes(i)
        np.testing.assert_allclose(view.read().stokes, truth, atol=atol)


@pytest.mark.parametrize("suffix", ["pgm", "tif", "png"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bare_mosaics_in_files_of_viewers(tmp_path, suffix, bits):
    for i in range(2):
        write(tmp_path / "images" / f"{i}.{suffix}", codes(mosaic(stokes(i)), bits), "Y")
    is_mosaic_of(tmp_path)


@pytest.mark.parametrize("suffix", ["bmp", "png", "tga", "tif"])
@pytest.mark.parametrize("told", [True, False])
def test_three_equal_channels_are_one(tmp_path, suffix, told):
    for i in range(2):
        write(tmp_path / "images" / f"{i}.{suffix}", np.repeat(codes(mosaic(stokes(i)), 8)[..., None], 3, -1))
    if told:
        (tmp_path / "capture.toml").write_text('[mosaic]\ncolour = "mono"\n')
    is_mosaic_of(tmp_path)


def test_grey_with_alpha_is_one_channel(tmp_path):
    for i in range(2):
        grey = codes(mosaic(stokes(i)))
        write(tmp_path / "images" / f"{i}.png", np.stack([grey, np.full_like(grey, 65535)], -1), "Y A")
    capture = is_mosaic_of(tmp_path)
    assert capture.views[0].read().alpha is not None


def test_a_mosaic_that_is_told_but_has_colours_is_refused(tmp_path):
    write(tmp_path / "images" / "a.png", codes(stokes(0)[:, :, 0]))
    (tmp_path / "capture.toml").write_text('[mosaic]\ncolour = "mono"\n')
    with pytest.raises(UserError, match=r"\[mosaic\] is told, but.*a\.png.*differ"):
        open_capture(tmp_path)


def test_arrays_are_images(tmp_path):
    for i in range(2):
        (tmp_path / "m" / "images").mkdir(parents=True, exist_ok=True)
        (tmp_path / "c" / "images").mkdir(parents=True, exist_ok=True)
        (tmp_path / "s" / "images").mkdir(parents=True, exist_ok=True)
        np.save(tmp_path / "m" / "images" / f"{i}.npy", codes(mosaic(stokes(i))))
        np.save(tmp_path / "c" / "images" / f"{i}.npy", stokes(i)[:, :, 0].astype(np.float64))
        np.save(tmp_path / "s" / "images" / f"{i}.npy", np.stack([behind(stokes(i), a).mean(-1) for a in ANGLES]))
    is_mosaic_of(tmp_path / "m")
    for i, view in enumerate(open_capture(tmp_path / "c").views):
        np.testing.assert_allclose(view.read().rgb, stokes(i)[:, :, 0], atol=1e-6)
    is_stack_of(open_capture(tmp_path / "s"), 1e-5, grey=True)


@pytest.mark.parametrize(
    "array", [np.zeros((3, 20, 30)), np.zeros(7), np.zeros((5, 6), complex), np.array([{}], object), np.full((9, 9), -4)]
)
def test_arrays_that_are_no_image_are_refused(tmp_path, array):
    (tmp_path / "images").mkdir()
    np.save(tmp_path / "images" / "a.npy", array, allow_pickle=True)
    with pytest.raises(UserError, match=r"a\.npy: .+; .+"):
        open_capture(tmp_path)


RAW = "[raw]\nwidth = {0}\nheight = {0}\nformat = '{1}'\n"


@pytest.mark.parametrize("name", ["Mono8", "Mono12", "Mono16", "Mono10p", "Mono12p", "Mono12Packed"])
def test_bare_samples_of_told_size(tmp_path, name):
    bits = int("".join(c for c in name if c.isdigit()))
    (tmp_path / "images").mkdir()
    for i in range(2):
        values = np.round(mosaic(stokes(i)) * (2**bits - 1)).astype(np.uint16).ravel()
        (tmp_path / "images" / f"{i}.raw").write_bytes(packed(values, name))
    with pytest.raises(UserError, match=r"0\.raw: .*raw\.width"):
        open_capture(tmp_path)
    (tmp_path / "capture.toml").write_text(RAW.format(SIDE, name))
    is_mosaic_of(tmp_path)
    (tmp_path / "capture.toml").write_text(RAW.format(SIDE - 2, name))
    with pytest.raises(UserError, match=r"0\.raw: has \d+ bytes"):
        open_capture(tmp_path)


def packed(values, name):
    """Samples as a camera streams them, bit by bit."""
    if name.endswith("p"):
        bits = int(name[4:-1])
        every = (values[:, None] >> np.arange(bits)) & 1
        return np.packbits(every.astype(np.uint8).ravel(), bitorder="little").tobytes()
    if name.endswith("Packed"):
        a, b = values.reshape(-1, 2).T
        return np.stack([a >> 4, (b & 15) << 4 | a & 15, b >> 4], -1).astype(np.uint8).tobytes()
    return values.astype("<u2" if name != "Mono8" else np.uint8).tobytes()


def test_packed_samples_of_an_odd_count():
    values = np.array([4095, 1, 2048], np.uint16)
    assert unpacked(np.frombuffer(packed(values, "Mono12p"), np.uint8), 12, "p", 3).tolist() == values.tolist()


@pytest.mark.parametrize("grey", [False, True])
def test_four_pages_are_four_angles(tmp_path, grey):
    for i in range(2):
        images = [codes(behind(stokes(i), a)) for a in ANGLES]
        images = [im.mean(-1).astype(np.uint16)[..., None] for im in images] if grey else images
        write_parts(tmp_path / "images" / f"{i}.tif", {str(k): (im, "Y" if grey else "R G B") for k, im in enumerate(images)})
    is_stack_of(open_capture(tmp_path), 1e-3, grey)


def test_planes_of_one_tiff_page_are_angles(tmp_path):
    (tmp_path / "images").mkdir()
    for i in range(2):
        planes = np.stack([codes(behind(stokes(i), a).mean(-1)) for a in ANGLES])
        tifffile.imwrite(tmp_path / "images" / f"{i}.tif", planes, photometric="minisblack", planarconfig="separate")
    is_stack_of(open_capture(tmp_path), 1e-3, grey=True)


@pytest.mark.parametrize("suffix", ["tif", "png"])
def test_angles_in_red_green_blue_and_alpha_are_seen_by_their_pixels(tmp_path, suffix):
    for i in range(2):
        planes = np.stack([codes(behind(stokes(i), a).mean(-1)) for a in ANGLES], -1)
        write(tmp_path / "images" / f"{i}.{suffix}", planes, "R G B A", oiio__UnassociatedAlpha=1)
    is_stack_of(open_capture(tmp_path), 1e-3, grey=True)


def test_colour_with_a_mask_in_alpha_stays_colour(tmp_path):
    alpha = np.zeros((SIDE, SIDE, 1), np.uint16)
    alpha[8:40, 8:40] = 65535
    write(tmp_path / "images" / "a.png", np.concatenate([codes(stokes(0)[:, :, 0]), alpha], -1), "R G B A")
    capture = open_capture(tmp_path)
    assert capture.polarisation == "none" and capture.masks == "alpha"


def test_pages_of_other_angles_are_told_or_refused(tmp_path):
    for i in range(2):
        pages = {str(k): (codes(behind(stokes(i), a)), "R G B") for k, a in enumerate((0, 60, 120))}
        write_parts(tmp_path / "images" / f"{i}.tif", pages)
    with pytest.raises(UserError, match=r"0\.tif: holds 3 images; .*stack\.angles_deg"):
        open_capture(tmp_path)
    (tmp_path / "capture.toml").write_text('[stack.angles_deg]\n"1" = 0\n"2" = 60\n"3" = 120\n')
    is_stack_of(open_capture(tmp_path), 1e-3)


def test_a_thumbnail_page_is_no_second_image(tmp_path):
    (tmp_path / "images").mkdir()
    with tifffile.TiffWriter(tmp_path / "images" / "a.tif") as out:
        out.write(codes(stokes(0)[:, :, 0]), photometric="rgb")
        out.write(codes(stokes(0)[::4, ::4, 0], 8), photometric="rgb", subfiletype=1)
    assert open_capture(tmp_path).views[0].read().rgb.shape == (SIDE, SIDE, 3)


def half(image):
    return image.astype(np.float16)


def test_parts_and_channels_of_exr_that_are_angles(tmp_path):
    for i in range(2):
        pictures = {str(a): half(behind(stokes(i), a)) for a in ANGLES}
        write_parts(tmp_path / "parts" / "images" / f"{i}.exr", {k: (v, "R G B") for k, v in pictures.items()})
        names = " ".join(f"I{a}.{c}" for a in ANGLES for c in "RGB")
        write(tmp_path / "layers" / "images" / f"{i}.exr", np.concatenate(list(pictures.values()), -1), names)
        greys = np.stack([v.astype(np.float32).mean(-1) for v in pictures.values()], -1)
        write(tmp_path / "channels" / "images" / f"{i}.exr", greys, "0 45 90 135")
    is_stack_of(open_capture(tmp_path / "parts"), 2e-3)
    is_stack_of(open_capture(tmp_path / "layers"), 2e-3)
    is_stack_of(open_capture(tmp_path / "channels"), 2e-3, grey=True)


@pytest.mark.parametrize("prefix", ["", "ViewLayer."])
def test_stokes_in_parts_and_layers(tmp_path, prefix):
    for i in range(2):
        light = half(stokes(i))
        write_parts(tmp_path / "parts" / "images" / f"{i}.exr", {f"{prefix}S{k}": (light[:, :, k], "R G B") for k in range(3)})
        names = " ".join(f"{prefix}S{k}.{c}" for k in range(3) for c in "RGB")
        write(tmp_path / "layers" / "images" / f"{i}.exr", light.reshape(SIDE, SIDE, 9), names)
    is_stack_of(open_capture(tmp_path / "parts"), 1e-3)
    is_stack_of(open_capture(tmp_path / "layers"), 1e-3)


@pytest.mark.parametrize("title", ["", "rgba", "ViewLayer.Combined"])
def test_the_picture_among_parts_is_the_coloured_one(tmp_path, title):
    rgb, depth = half(stokes(0)[:, :, 0]), np.full((SIDE, SIDE, 1), 7, np.float16)
    write_parts(tmp_path / "images" / "a.exr", {"depth": (depth, "Z"), title or "x": (rgb, "R G B")})
    np.testing.assert_array_equal(open_capture(tmp_path).views[0].read().rgb, rgb.astype(np.float32))


def test_the_layer_that_is_the_picture(tmp_path):
    rgb, normal = half(stokes(0)[:, :, 0]), half(stokes(1)[:, :, 0])
    both = np.concatenate([rgb, normal, half(np.ones((SIDE, SIDE, 1)))], -1)
    names = [f"ViewLayer.{p}.{c}" for p in ("Combined", "DiffCol") for c in "RGB"]
    write(tmp_path / "a" / "images" / "a.exr", both, " ".join([*names, "ViewLayer.Depth.Z"]))
    np.testing.assert_array_equal(open_capture(tmp_path / "a").views[0].read().rgb, rgb.astype(np.float32))
    names = [f"{p}.{c}" for p in ("left", "right") for c in "RGB"]
    write(tmp_path / "b" / "images" / "a.exr", both[..., :6], " ".join(names))
    with pytest.raises(UserError, match=r"a\.exr.*2 coloured layers \(left, right\)"):
        open_capture(tmp_path / "b").views[0].read()


def test_parts_among_which_none_is_the_picture_are_refused(tmp_path):
    views = {name: (half(stokes(k)[:, :, 0]), "R G B") for k, name in enumerate(("left", "right"))}
    write_parts(tmp_path / "images" / "a.exr", views)
    with pytest.raises(UserError, match=r"a\.exr: holds 2 images \(left, right\)"):
        open_capture(tmp_path)


@pytest.mark.parametrize("name", ["a.psd", "a.heic", "a.gif", "a.jp2", "a.avif"])
def test_files_that_nobody_reads_are_named_with_the_way_out(tmp_path, name):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / name).write_bytes(b"x")
    with pytest.raises(UserError, match=rf"{name}: cannot be read; "):
        open_capture(tmp_path)


def test_dolp_of_pages_is_right(tmp_path):
    write_parts(tmp_path / "images" / "a.tif", {str(k): (codes(behind(stokes(0), a)), "R G B") for k, a in enumerate(ANGLES)})
    np.testing.assert_allclose(dolp(open_capture(tmp_path).views[0].read().stokes), dolp(stokes(0)), atol=2e-3)
