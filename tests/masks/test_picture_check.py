"""Wrong cameras with sound outlines are told by points that pictures share; moving light and still backgrounds are not."""

from __future__ import annotations

import re

import numpy as np
import pytest

from pipeline.geometry.camera_slips import mirrored, turned, with_centre, with_focal
from stages.masks.picture_check import chosen_views, matches_doubt, picture_doubt
from stages.masks.picture_matches import Matches, features, matched
from synth.ball import ring

SIZE = 144
CAMERAS = dict(zip((f"{k:02d}" for k in range(10)), ring(24, SIZE, rises=(0.05, 0.35))))
RNG = np.random.default_rng(3)
SEEDS, SHADES = RNG.normal(size=(300, 3)), RNG.random(300).astype(np.float32)
SEEDS /= np.linalg.norm(SEEDS, axis=1, keepdims=True)


def tiled(camera) -> np.ndarray:
    """A ball of many tiles [H, W], black around it: its outline is the same in all views."""
    rays, origin = camera.rays(), camera.centre
    along = rays @ origin
    root = along**2 - origin @ origin + 0.8**2
    place = origin + rays * (-along - np.sqrt(np.maximum(root, 0)))[..., None]
    return np.where(root > 0, 0.1 + SHADES[(place.reshape(-1, 3) @ SEEDS.T).argmax(1)].reshape(root.shape), 0)


GREY = {view: tiled(camera).astype(np.float32) for view, camera in CAMERAS.items()}
MASKS = {view: grey > 0 for view, grey in GREY.items()}
LISTED = list(CAMERAS.values())


def doubt(cameras, grey=GREY, masks=MASKS):
    return picture_doubt(dict(zip(CAMERAS, cameras)), grey.__getitem__, masks)


def test_sound_cameras_get_no_line():
    assert doubt(LISTED, masks={}) is None


def exact_matches(noise: float, outliers: float) -> Matches:
    """Points of a cloud in all views of RINGED, some in a wrong place."""
    points = RNG.normal(size=(60, 3)) * 0.4
    places = np.stack([camera.project(points)[0] for camera in RINGED])
    found = places + RNG.normal(scale=noise, size=places.shape)
    wrong = RNG.random(places.shape[:2]) < outliers
    found[wrong] = RNG.uniform(0, 512, (int(wrong.sum()), 2))
    pairs = np.array([(i, j) for i in range(len(RINGED)) for j in (i + 1, i + 2) if j < len(RINGED)], np.intp)
    first, second = (found[pairs[:, k]].reshape(-1, 2) for k in (0, 1))
    return Matches(pairs.repeat(len(points), 0), first, second, found.size // 2)


RINGED = ring(12, 512, rises=(0.05, 0.35, 0.6))
MATCHES = exact_matches(0.4, 0.15)
MIXED = [3, 7, 11, 0, 9, 5, 1, 8, 2, 6, 10, 4]


def told(cameras) -> str | None:
    return matches_doubt({f"{k:02d}": camera for k, camera in enumerate(cameras)}, MATCHES)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (with_focal(RINGED, 2), r"all focal lengths times 0\.(49|50|51) fit"),
        (with_focal(RINGED, 0.7), r"all focal lengths times 1\.4\d fit"),
        (with_centre(RINGED, 0.05, 0.05), r"principal points at 25[5-7], 25[5-7] of 512x512 fit"),
        (mirrored(RINGED, (1, 1, -1)), "mirrored in z"),
        (RINGED[::-1], "in the opposite order"),
        ([RINGED[k] for k in MIXED], "poses in another order fit"),
        ([*RINGED[:4], turned(RINGED[4], np.radians([0, 5, 0])), *RINGED[5:]], r": 04 \(.*turned by 5\.0 degrees it would fit"),
    ],
)
def test_matches_name_the_mistake(wrong, words):
    assert re.search(words, told(wrong) or "nothing was said")


def test_matches_of_sound_cameras_say_nothing():
    assert told(RINGED) is None


def two_objects(second, share: float) -> Matches:
    """Matches of views up to four steps apart, of which those between the objects are chance, and `share` of them are there."""
    points = RNG.normal(size=(40, 3)) * 0.4
    places = np.stack([camera.project(points)[0] for camera in RINGED])
    pairs = np.array([(i, j) for i in range(12) for j in range(i + 1, 12) if min(j - i, 12 - j + i) <= 4], np.intp)
    first, second_ = (places[pairs[:, k]].reshape(-1, 2) + RNG.normal(scale=0.3, size=(40 * len(pairs), 2)) for k in (0, 1))
    pairs = pairs.repeat(40, 0)
    across = np.isin(pairs, second).sum(1) == 1
    first[across] = RNG.uniform(0, 512, (int(across.sum()), 2))
    kept = ~across | (RNG.random(len(across)) < share)
    return Matches(pairs[kept], first[kept], second_[kept], places.size // 2)


@pytest.mark.parametrize("share", [1.0, 0.05])
def test_two_objects_in_turn_are_told_as_that(share):
    found = matches_doubt({f"{k:02d}": c for k, c in enumerate(RINGED)}, two_objects(range(1, 12, 2), share))
    assert found is not None and "6 (00, 02, 04, 06 and 2 more) and 6 (01, 03, 05, 07 and 2 more)" in found


def test_two_sides_of_a_board_are_no_two_objects():
    """Neighbours at its edges show other sides."""
    assert matches_doubt({f"{k:02d}": c for k, c in enumerate(RINGED)}, two_objects(range(6, 12), 0.05)) is None


def test_pictures_name_a_mirrored_world():
    assert "mirrored in x" in (doubt(mirrored(LISTED, (-1, 1, 1))) or "")


def test_a_still_background_tells_nothing():
    rng = np.random.default_rng(0)
    room = rng.random((SIZE, SIZE)).astype(np.float32)
    before = {view: np.where(MASKS[view], GREY[view].mean(), room) for view in CAMERAS}
    assert doubt(with_focal(LISTED, 2), before, {}) is None


def test_what_follows_no_camera_tells_nothing():
    rng = np.random.default_rng(1)
    spots = rng.random((16, 16)).repeat(9, 0).repeat(9, 1).astype(np.float32)
    moving = {view: np.roll(spots, (9 * k % 31, -7 * k % 23), (0, 1)) for k, view in enumerate(CAMERAS)}
    assert len(matched(*zip(*(features(m, None)[:2] for m in moving.values()))).pairs) > 60
    assert doubt(LISTED, moving, {}) is None


def test_pictures_without_features_tell_nothing():
    assert doubt(with_focal(LISTED, 2), dict.fromkeys(CAMERAS, np.zeros((SIZE, SIZE), np.float32))) is None


def test_of_many_views_neighbours_are_looked_at():
    chosen = chosen_views([10**6] * 200)
    assert len(chosen) == 40 and chosen[:4] == [0, 1, 2, 3] and chosen[-1] == 199
    assert len(chosen_views([20_000_000] * 200)) == 12 and chosen_views([1] * 8) == list(range(8))
