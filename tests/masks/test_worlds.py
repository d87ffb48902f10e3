"""Masks of two cameras with poses of two worlds have no common hull; masks of one world have."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stages.masks.worlds import other_world


def named(cameras, name, turn=None, scale=1.0, shift=(0, 0, 0)):
    """The cameras under a name, in a world turned, scaled and moved."""
    out = []
    for camera in cameras:
        pose = np.eye(4)
        pose[:3, :3] = camera.world_to_camera[:3, :3] @ (np.eye(3) if turn is None else turn.T)
        centre = scale * (camera.centre if turn is None else turn @ camera.centre) + np.asarray(shift)
        pose[:3, 3] = -pose[:3, :3] @ centre
        out.append(replace(camera, world_to_camera=pose, name=name))
    return out


@pytest.mark.slow
def test_two_worlds_are_reported_and_one_is_not(views):
    even, odd = views.cameras[::2], views.cameras[1::2]
    masks = [*views.masks[::2], *views.masks[1::2]]
    turn = Rotation.from_euler("xyz", [50, 80, 10], degrees=True).as_matrix()
    assert other_world(masks, [*named(even, "a"), *named(odd, "b")]) is None
    for world in ({"turn": turn, "scale": 0.37, "shift": (1, 2, -0.5)}, {"turn": turn}, {"shift": (0.8, 0, 0)}):
        assert other_world(masks, [*named(even, "a"), *named(odd, "b", **world)]) == ("a", "b"), world


def test_masks_that_do_not_agree_among_themselves_accuse_no_camera(views):
    mixed = [views.masks[(5 * k + 3) % 14] for k in range(14)]
    cameras = [*named(views.cameras[:7], "a"), *named(views.cameras[7:], "b")]
    assert other_world(mixed, cameras) is None
