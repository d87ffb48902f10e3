"""Cameras and masks that were given the wrong way round are told as that, and sound ones get no word."""

import dataclasses
import json

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.formats.images import write_png
from stages.masks.doubts import inverted, looking_away, one_sided
from synth import ball


def turned(camera, matrix):
    pose = np.linalg.inv(np.linalg.inv(camera.world_to_camera) @ matrix)
    return dataclasses.replace(camera, world_to_camera=pose)


def test_cameras_of_negated_axes_look_away():
    cameras = ball.ring(12)
    assert looking_away(cameras) is None and one_sided(cameras) is None
    away = [turned(camera, np.diag([1, -1, -1, 1])) for camera in cameras]
    assert "12 of 12 cameras look away" in (one_sided(away) or "")


def test_inverted_masks_are_counted_and_whole_or_cut_ones_are_not():
    masks = [ball.picture(camera)[2] for camera in ball.ring(4)]
    assert inverted(masks) == 0 and inverted([~m for m in masks]) == 4
    assert inverted([np.ones((8, 8), bool), np.zeros((8, 8), bool)]) == 0
    facade = np.ones((20, 20), bool)
    facade[:3] = False
    assert inverted([facade]) == 0


@pytest.mark.parametrize(("folder", "used"), [("masks", True), ("Masks", True), ("MASK", True), ("segmentation", False)])
def test_masks_in_a_folder_of_another_name_are_used_or_named(tmp_path, folder, used):
    cameras = ball.ring(3)
    names = [f"images/{k}.png" for k in range(3)]
    for name, camera in zip(names, cameras):
        colour, _, mask = ball.picture(camera)
        ball.write(tmp_path / name, ball.codes(colour))
        (tmp_path / folder).mkdir(exist_ok=True)
        write_png(tmp_path / folder / name.split("/")[1], np.where(mask, 255, 0).astype(np.uint8))
    (tmp_path / "transforms.json").write_text(json.dumps(ball.transforms(cameras, names)))
    capture = open_capture(tmp_path)
    assert (capture.masks is not None) == used
    assert any("name the folder masks/" in line for line in capture.warnings) != used


def test_grey_pictures_of_another_kind_are_not_taken_for_masks(tmp_path):
    cameras = ball.ring(3)
    names = [f"images/{k}.png" for k in range(3)]
    for name, camera in zip(names, cameras):
        colour, _, _ = ball.picture(camera)
        ball.write(tmp_path / name, ball.codes(colour))
        ball.write(tmp_path / "depth" / name.split("/")[1], ball.codes(colour[..., 0], 8))
    (tmp_path / "transforms.json").write_text(json.dumps(ball.transforms(cameras, names)))
    assert open_capture(tmp_path).warnings == ()
