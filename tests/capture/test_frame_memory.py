"""Frames' memory is used again only when nothing looks at it any more."""

import numpy as np

from pipeline.capture.pixels import frame_memory
from pipeline.capture.pixels.frame_memory import SMALL, frame_array

SHAPE = (SMALL // 4, 4)


def test_memory_in_use_is_never_handed_out_again():
    first = frame_array(SHAPE)
    first[:] = 1
    view = first[::2].T
    del first
    second = frame_array(SHAPE)
    second[:] = 2
    assert (view == 1).all()


def test_memory_is_used_again_for_frames_of_the_same_size():
    frame_memory._free.clear()
    first = frame_array(SHAPE)
    place = first.__array_interface__["data"][0]
    del first
    again = frame_array(SHAPE, np.uint32)
    assert again.__array_interface__["data"][0] == place and again.shape == SHAPE and again.dtype == np.uint32
