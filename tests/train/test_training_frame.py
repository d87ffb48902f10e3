"""The training frame: proper rotations, depth and directions that come back, whatever the world's axes and units."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.cameras import Camera
from pipeline.geometry.world import Y_UP_FROM
from stages.train.views.training_frame import SceneFrame

from .conftest import look_at

UP = {"y": [0, 1, 0], "-y": [0, -1, 0], "z": [0, 0, 1], "-z": [0, 0, -1], "x": [1, 0, 0], "-x": [-1, 0, 0]}


@pytest.mark.parametrize("up", sorted(Y_UP_FROM))
def test_every_up_axis_turns_to_y_by_a_rotation(up):
    frame = SceneFrame.of(up, np.array([1.0, -2, 3]), 7.0)
    assert np.linalg.det(frame.train_from_world) == pytest.approx(1)
    assert np.allclose(frame.train_from_world @ UP[up], [0, 1, 0])
    points = np.random.default_rng(0).normal(size=(5, 3))
    back = (frame.points_to_world(points) - np.array(frame.centre)) @ frame.train_from_world.T / 7.0
    assert np.allclose(back, points)


def test_z_up_is_the_turn_that_environment_maps_use():
    assert np.allclose(SceneFrame.of("z", np.zeros(3), 1).train_from_world @ [1, 2, 3], [1, 3, -2])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_a_framed_camera_sees_the_same_picture(scale):
    camera = Camera(64, 48, 80, 80, 32, 24, look_at(np.array([1.0, 0.4, 0.2]), 5 * scale))
    frame = SceneFrame.of("-z", np.array([0.1, 0.2, 0.3]) * scale, 2.0 * scale)
    points = np.random.default_rng(1).normal(size=(20, 3))
    world = frame.points_to_world(points)
    (a, depth_a), (b, depth_b) = camera.project(world), frame.camera(camera).project(points)
    assert np.allclose(a, b) and np.allclose(depth_a, depth_b * frame.scale)
    assert np.allclose(frame.directions_to_world(frame.camera(camera).rays()), camera.rays())
