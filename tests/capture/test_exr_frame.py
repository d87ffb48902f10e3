"""An EXR's picture is its display window in Rec. 709, whichever way it is read."""

import json

import numpy as np
import OpenImageIO as oiio
import pytest

from pipeline.capture import open_capture
from pipeline.capture.config import RadiometryConfig
from pipeline.capture.pixels.linear import read_linear
from pipeline.errors import UserError
from pipeline.formats.exr_frame import REC709, to_rec709
from pipeline.formats.exr_zip import open_zip_exr
from pipeline.formats.images import STOKES, image_size, read_image
from stages.olat.reading.frame_reader import is_half, read_rows
from tests.capture.little_captures import ANGLES, SIDE, behind, stokes, write_parts

SIZE = (40, 30)
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
ACESCG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)


def picture(channels=3):
    rng = np.random.default_rng(3)
    return rng.uniform(0.1, 1, (SIZE[1], SIZE[0], channels)).astype(np.float16).astype(np.float32)


def write(path, pixels, window=None, display=(0, 0), kind="half", compression="zip", names="RGB", tiles=0, **attributes):
    """The part `window` (x0, y0, x1, y1 in the picture) of pixels; `display`: the display window's corner."""
    x0, y0, x1, y1 = window or (0, 0, pixels.shape[1], pixels.shape[0])
    spec = oiio.ImageSpec(x1 - x0, y1 - y0, pixels.shape[2], kind)
    spec.x, spec.y, (spec.full_x, spec.full_y) = x0 + display[0], y0 + display[1], display
    spec.full_width, spec.full_height = pixels.shape[1], pixels.shape[0]
    spec.channelnames = tuple(names)
    spec.attribute("compression", compression)
    if tiles:
        spec.tile_width = spec.tile_height = tiles
    if "chromaticities" in attributes:
        spec.attribute("chromaticities", "float[8]", attributes["chromaticities"])
    big = np.zeros((y1 - y0, x1 - x0, pixels.shape[2]), np.float32)
    inside = pixels[max(y0, 0) : y1, max(x0, 0) : x1]
    big[max(-y0, 0) : max(-y0, 0) + inside.shape[0], max(-x0, 0) : max(-x0, 0) + inside.shape[1]] = inside
    path.parent.mkdir(parents=True, exist_ok=True)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(big) and out.close()


def every_reading(path, half=True):
    """The picture by each of the readers."""
    assert image_size(path) == SIZE
    linear = read_linear(path, RadiometryConfig())
    order = [linear.names.index(c) for c in "RGB"]
    yield linear.pixels[..., order]
    yield read_image(path, "RGB")
    assert is_half(path) == half
    rows = [read_rows(path, a, b, *SIZE, half) for a, b in ((0, 7), (7, 30))]
    yield np.concatenate([r.view(np.float16).astype(np.float32) if half else r for r in rows])


@pytest.mark.parametrize("compression", ["zip", "zips", "piz"])
@pytest.mark.parametrize("window", [(6, 8, 33, 25), (-5, -4, 46, 37), (10, -3, 60, 12), (0, 0, 40, 30)])
@pytest.mark.parametrize("display", [(0, 0), (-7, 12)])
def test_the_stored_part_lies_in_the_display_window(tmp_path, window, display, compression):
    path, pixels = tmp_path / "a.exr", picture()
    write(path, pixels, window, display, compression=compression)
    x0, y0, x1, y1 = window
    want = np.zeros_like(pixels)
    want[max(y0, 0) : y1, max(x0, 0) : x1] = pixels[max(y0, 0) : y1, max(x0, 0) : x1]
    for found in every_reading(path):
        np.testing.assert_array_equal(found, want)
    fast = open_zip_exr(path)
    assert (fast is not None) == (window == (0, 0, 40, 30) and compression != "piz")
    if fast is not None:
        fast.file.close()


def test_a_part_in_tiles(tmp_path):
    write(tmp_path / "a.exr", picture(), (6, 8, 33, 25), tiles=16)
    want = np.zeros_like(picture())
    want[8:25, 6:33] = picture()[8:25, 6:33]
    for found in every_reading(tmp_path / "a.exr"):
        np.testing.assert_array_equal(found, want)


def test_a_data_window_beside_the_display_window_is_refused(tmp_path):
    write(tmp_path / "a.exr", np.zeros((30, 40, 3), np.float32), (50, 0, 60, 10))
    with pytest.raises(UserError, match=r"a\.exr.*outside its display window"):
        image_size(tmp_path / "a.exr")


def test_primaries_are_those_of_the_colorimetric_standards():
    """Against ACES's published AP0 and AP1 to Rec. 709 matrices (with Bradford's adaptation from its white to D65)."""
    from_acescg = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    from_aces = [[2.52169, -1.13413, -0.38756], [-0.27648, 1.37272, -0.09624], [-0.01538, -0.15298, 1.16835]]
    np.testing.assert_allclose(to_rec709(ACESCG), from_acescg, atol=2e-4)
    np.testing.assert_allclose(to_rec709(ACES), from_aces, atol=2e-4)
    np.testing.assert_allclose(to_rec709((1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3)).sum(1), 1, atol=1e-5)  # XYZ: white stays white
    assert to_rec709(REC709) is None and to_rec709(None) is None and to_rec709((0.3,) * 8) is None


@pytest.mark.parametrize("compression", ["zip", "piz"])
def test_colours_of_other_primaries_become_rec709_and_it_is_said(tmp_path, compression):
    path, pixels = tmp_path / "images/a.exr", picture()
    write(path, pixels, compression=compression, chromaticities=ACESCG)
    want = pixels @ to_rec709(ACESCG).T
    for found in every_reading(path, half=False):
        np.testing.assert_allclose(found, want, atol=1e-6)
    view = open_capture(tmp_path).view("a").read()
    assert view.verbatim is None and any("Rec. 709" in fault for fault in view.faults)
    write(path, pixels, compression=compression, chromaticities=REC709)
    view = open_capture(tmp_path).view("a").read()
    assert view.verbatim == path and not view.faults
    np.testing.assert_array_equal(view.rgb, pixels)


def test_stokes_vectors_are_converted_and_placed_as_colours_are(tmp_path):
    pixels = picture(9)
    pixels[..., 3:] *= 0.125
    write(tmp_path / "images/a.exr", pixels, (4, 0, 40, 20), names=STOKES, chromaticities=ACES)
    frame = {"file_path": "images/a.exr", "transform_matrix": np.eye(4).tolist(), "camera_angle_x": 0.5}
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [frame]}))
    capture = open_capture(tmp_path)
    camera = capture.cameras["a"]
    assert (camera.width, camera.height, camera.cx, camera.cy) == (40, 30, 20, 15)
    view = capture.view("a").read()
    assert view.verbatim is None
    want = pixels.reshape(30, 40, 3, 3) @ to_rec709(ACES).T
    want[20:], want[:, :4] = 0, 0
    np.testing.assert_allclose(view.stokes, want, atol=1e-6)


@pytest.mark.parametrize("parts", ["angles", "stokes", "layer"])
def test_parts_and_layers_lie_in_their_display_window(tmp_path, parts):
    kept = (slice(6, 40), slice(8, 44))
    inside = np.zeros((SIDE, SIDE, 1, 1), bool)
    inside[kept] = True
    for i in range(2):
        light = stokes(i)
        if parts == "angles":
            found = {str(a): (behind(light, a).astype(np.float16), "R G B") for a in ANGLES}
        elif parts == "stokes":
            found = {f"S{k}": (light[:, :, k].astype(np.float16), "R G B") for k in range(3)}
        else:
            names = " ".join(f"ViewLayer.S{k}.{c}" for k in range(3) for c in "RGB")
            found = {"picture": (light.reshape(SIDE, SIDE, 9).astype(np.float16), names)}
        write_parts(tmp_path / "images" / f"{i}.exr", found, kept)
    for i, view in enumerate(open_capture(tmp_path).views):
        np.testing.assert_allclose(view.read().stokes, np.where(inside, stokes(i), 0), atol=2e-3)
