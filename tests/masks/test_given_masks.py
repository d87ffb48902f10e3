"""Masks that came with a capture: what their values mean, what tells nothing, and when a segmentation has failed."""

import warnings

import numpy as np
import pytest

from pipeline.formats.given_mask import read_given
from pipeline.formats.images import write_png
from pipeline.geometry.cameras import Camera
from stages.masks.contour_check import contour_evidence
from stages.masks.doubts import one_sided, segmentation_faults
from stages.masks.unseen_side import furthest_from, unseen_side
from synth.orbit import fibonacci_sphere

from .conftest import look_at

OBJECT = np.zeros((20, 30), bool)
OBJECT[5:15, 8:22] = True


def written(path, pixels):
    import OpenImageIO as oiio

    pixels = np.asarray(pixels)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], str(pixels.dtype)))
    assert out.write_image(np.ascontiguousarray(pixels))
    out.close()
    return path


@pytest.mark.parametrize("low, high, kind", [(0, 1, "uint8"), (0, 1, "uint16"), (0, 100, "uint8"), (0, 3, "uint8")])
def test_masks_of_small_values_are_scaled_up_and_said(tmp_path, low, high, kind):
    mask = read_given(written(tmp_path / "m.png", np.where(OBJECT, high, low).astype(kind)))
    np.testing.assert_array_equal(mask.pixels > 127, OBJECT)
    assert mask.reading is not None and f"0, {high}" in mask.reading


def test_labels_of_several_parts_are_one_object(tmp_path):
    labels = OBJECT.astype(np.uint8)
    labels[10:15][OBJECT[10:15]] = 2
    mask = read_given(written(tmp_path / "m.png", labels))
    np.testing.assert_array_equal(mask.pixels > 127, OBJECT)


def test_plain_masks_are_taken_as_they_are(tmp_path):
    soft = np.where(OBJECT, 255, 0).astype(np.uint8)
    soft[5] = np.where(OBJECT[5], 90, 0)
    mask = read_given(written(tmp_path / "m.png", soft))
    assert mask.reading is None and not mask.whole and not mask.empty
    np.testing.assert_array_equal(mask.pixels, soft)


def test_masks_in_the_alpha_or_another_channel_are_found(tmp_path):
    white = np.where(OBJECT, 255, 0).astype(np.uint8)
    rgba = np.zeros((20, 30, 4), np.uint8)
    rgba[..., 3] = white
    alpha = read_given(written(tmp_path / "a.png", rgba))
    blue = np.zeros((20, 30, 3), np.uint8)
    blue[..., 2] = white
    coloured = read_given(written(tmp_path / "b.png", blue))
    for mask, word in ((alpha, "alpha"), (coloured, "brightest")):
        np.testing.assert_array_equal(mask.pixels > 127, OBJECT)
        assert mask.reading is not None and word in mask.reading


def test_a_picture_that_is_cut_out_is_masked_by_its_alpha(tmp_path):
    rgba = np.random.default_rng(0).integers(0, 255, (20, 30, 4)).astype(np.uint8)
    rgba[..., 3] = np.where(OBJECT, 255, 0)
    mask = read_given(written(tmp_path / "m.png", rgba))
    np.testing.assert_array_equal(mask.inside, OBJECT)
    assert mask.reading is not None and "alpha" in mask.reading
    rgba[..., :3] = rgba[..., 3:]
    assert read_given(written(tmp_path / "w.png", rgba)).reading is None


def test_an_object_seen_edge_on_is_no_mask_of_two_values(tmp_path):
    thin = np.zeros((20, 30), np.uint8)
    thin[10] = np.linspace(0, 80, 30)
    assert read_given(written(tmp_path / "m.png", thin)).empty


def test_white_and_black_masks_are_known(tmp_path):
    write_png(tmp_path / "w.png", np.full((20, 30), 255, np.uint8))
    write_png(tmp_path / "k.png", np.zeros((20, 30), np.uint8))
    assert read_given(tmp_path / "w.png").whole and not read_given(tmp_path / "w.png").empty
    assert read_given(tmp_path / "k.png").empty and not read_given(tmp_path / "k.png").whole


def test_a_segmentation_of_one_object_is_not_doubted(views):
    assert segmentation_faults(views.masks) == []


def test_what_a_failed_segmentation_looks_like_is_said(views):
    rng = np.random.default_rng(0)
    frame = np.ones((96, 96), bool)
    ground = np.zeros((96, 96), bool)
    ground[40:] = True
    crumbs = rng.uniform(size=(96, 96)) > 0.8
    for mask, words in ((frame, "take the whole frame"), (ground, "grow out of the picture"), (crumbs, "are fragments"),
                        (~frame, "show nothing")):  # fmt: skip
        (line, *_) = [f for f in segmentation_faults([mask] * 9 + views.masks[:5]) if words in f]
        assert line.startswith("9 of 14")


def facing(azimuths, elevation=0.3):
    places = [4 * np.array([np.cos(elevation) * np.cos(a), np.sin(elevation), np.cos(elevation) * np.sin(a)]) for a in azimuths]
    return [look_at(place, 0.0, 96) for place in places]


def test_cameras_on_one_side_are_reported_and_rings_are_not(views):
    assert one_sided(views.cameras) is None
    assert one_sided(facing(np.linspace(0, 6, 12), 1.0)) is None  # a ring high above a turntable
    assert one_sided(facing(np.linspace(-0.3, 0.3, 12))) == "all cameras look from one side, within 16 degrees"
    assert one_sided(facing(np.linspace(-0.3, 0.3, 5))) is None  # too few to promise anything
    row = [Camera(96, 96, 120.0, 120.0, 48.0, 48.0, np.block([[np.eye(3), np.array([[k], [0], [5.0]])], [np.eye(4)[3:]]]))
           for k in range(9)]  # fmt: skip
    fault = one_sided(row)
    assert fault is not None and "parallel" in fault


def test_a_side_that_no_camera_faces_is_named_and_an_ordinary_orbit_is_not_doubted():
    low, high = np.radians([47, 70])
    above = {f"{k:03d}": c for k, c in enumerate(facing(np.linspace(0, 6, 6), low) + facing(np.linspace(0.5, 6.5, 6), high))}
    found = unseen_side(above)
    assert found is not None and found.towards @ (0, -1, 0) > 0.99 and abs(found.away_deg - 137) < 3 and found.nearest in above
    assert found.said("y").startswith("the underside of the object") and found.said("-y").startswith("the upper side")
    assert found.said("z").startswith("one side")
    for elevation in (-0.3, 0.0, 0.3, 0.55):  # radians: up to a ring 31 degrees above a turntable
        assert unseen_side(dict(zip(above, facing(np.linspace(0, 6, 12), elevation)))) is None
    assert unseen_side(dict(list(above.items())[:7])) is None  # too few to promise anything


def test_the_direction_furthest_from_others_is_that_of_a_dense_search():
    rng, sphere = np.random.default_rng(0), fibonacci_sphere(20_000)
    for _ in range(20):
        directions = rng.normal(size=(9, 3))
        directions[:, 2] += rng.uniform(0, 3)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        found, least = furthest_from(directions), (sphere @ directions.T).max(1).min()
        assert least > -0.02 if found is None else abs((directions @ found).max() - least) < 0.02


def test_bad_pixels_do_not_overflow_the_outline_check(views):
    rng = np.random.default_rng(1)
    stokes = rng.normal(0.2, 0.05, (96, 96, 3)).astype(np.float32)
    stokes[::7, ::5] = 1e38
    stokes[::11, ::3] = -1e38
    stokes[1::13, ::3, 1] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        evidence = contour_evidence([stokes], [views.masks[0]])
    assert np.isfinite(abs(evidence.as_is)) and abs(evidence.as_is) <= 1
