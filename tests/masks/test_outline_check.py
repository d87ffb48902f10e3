"""Wrong cameras whose outlines nearly agree are told by tangent planes of pairs of views; sound ones and poor masks are not."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.geometry.camera_slips import mirrored, turned, with_centre, with_focal
from pipeline.geometry.outline_tangents import hull_points, tangent_errors
from stages.masks.outline_check import misfit, outline_doubt
from synth.ball import ring

SIZE = 192
CAMERAS = ring(12, SIZE, rises=(-0.1, 0.35, 0.6))
CORNERS = np.random.default_rng(5).normal(size=(12, 3)) * [0.5, 0.35, 0.42]


def silhouette(camera) -> np.ndarray:
    """Mask of the convex hull of some points in space."""
    pixels = cv2.convexHull(np.round((camera.project(CORNERS)[0] - 0.5) * 16).astype(np.int32))
    return cv2.fillConvexPoly(np.zeros((SIZE, SIZE), np.uint8), pixels, 1, shift=4) > 0


MASKS = {f"{k:03d}": silhouette(camera) for k, camera in enumerate(CAMERAS)}


def doubt(cameras, masks=MASKS):
    return outline_doubt(dict(zip(MASKS, cameras)), masks)


def test_outlines_of_true_cameras_fit_to_a_fraction_of_a_pixel():
    points = np.stack([hull_points(mask) for mask in MASKS.values()])
    pairs, errors = tangent_errors(CAMERAS, points)
    assert len(pairs) > 60 and np.median(np.abs(errors)) < 0.3 and misfit(CAMERAS, points) < 0.25
    assert doubt(CAMERAS) is None


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (with_focal(CAMERAS, 2), r"all focal lengths times 0.[45]\d fit"),
        (with_focal(CAMERAS, 0.5), r"all focal lengths times (1.9|2.0)\d fit"),
        (with_centre(CAMERAS, 0.08, -0.05), r"principal points at 9[67], 9[67] of 192x192 fit"),
        (mirrored(CAMERAS, (-1, 1, 1)), "mirrored in x"),
        (CAMERAS[::-1], "in the opposite order"),
        (CAMERAS[1:] + CAMERAS[:1], "of the previous picture"),
        ([CAMERAS[k] for k in sorted(range(12), key=str)], "in the order of numbers"),
        ([turned(c, np.array([0, 0, np.pi])) for c in CAMERAS], "turned upside down"),
        ([turned(c, np.array([0, 0, np.pi / 2])) for c in CAMERAS], "turned by 90 degrees counter-clockwise"),
    ],
)
def test_one_mistake_of_all_cameras_is_named(wrong, words):
    found = doubt(wrong)
    assert found is not None and re.search(words, found)


def test_one_turned_camera_is_named_with_its_angle():
    wrong = [turned(c, np.radians([0, 4, 0])) if k == 5 else c for k, c in enumerate(CAMERAS)]
    found = doubt(wrong)
    assert found is not None and re.search(r": 005 \([\d.]+ px off; turned by 4.0 degrees it would fit\):", found)


def test_a_picture_stored_upside_down_is_named():
    found = doubt(CAMERAS, {**MASKS, "005": MASKS["005"][::-1, ::-1]})
    assert found is not None and re.search(r": 005 \([\d.]+ px off; turned by 1(79|80)\.\d degrees it would fit\):", found)


def others(camera) -> np.ndarray:
    """The outline of the object after it was turned and moved."""
    return silhouette(replace(camera, world_to_camera=camera.world_to_camera @ MOVED))


MOVED = np.eye(4)
MOVED[:3] = [[0.36, 0.48, -0.8, 0.1], [-0.8, 0.6, 0, 0.15], [0.48, 0.64, 0.6, -0.1]]


@pytest.mark.parametrize("second", [range(1, 12, 2), range(6, 12), range(8, 12)])
def test_two_objects_or_one_that_was_moved_are_told_as_that(second):
    masks = {view: others(c) if k in second else mask for k, (c, (view, mask)) in enumerate(zip(CAMERAS, MASKS.items()))}
    found = doubt(CAMERAS, masks)
    assert found is not None and f"{12 - len(second)} (000" in found and f"and {len(second)} ({second[0]:03d}" in found


def test_poor_masks_and_noisy_poses_are_not_taken_for_wrong_cameras():
    rng = np.random.default_rng(0)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    grown = {view: cv2.dilate(m.astype(np.uint8), kernel) > 0 if k % 2 else m for k, (view, m) in enumerate(MASKS.items())}
    noisy = [turned(c, np.radians(rng.normal(0, 0.3, 3))) for c in CAMERAS]
    assert doubt(CAMERAS, grown) is None and doubt(noisy) is None


def test_outlines_that_leave_the_picture_and_too_few_say_nothing():
    wrong = with_focal(CAMERAS, 2)
    assert doubt(wrong, {view: np.roll(m, -70, 0) | (np.arange(SIZE)[:, None] < 2) for view, m in MASKS.items()}) is None
    assert doubt(wrong, dict(list(MASKS.items())[:3])) is None
