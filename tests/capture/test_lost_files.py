"""Links to nothing, folders in a file's place and names that are no text: one line each, before any work."""

import os

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.errors import UserError
from pipeline.formats.images import write_rgb
from stages.relight.stage import STAGE as RELIGHT
from stages.train.parameters import TrainParameters


def test_a_link_to_nothing_in_the_captures_folder_is_named(tmp_path, scene, write):
    write.stokes_transforms(tmp_path, scene)
    assert open_capture(tmp_path).warnings == ()
    (tmp_path / "cameras.xml").symlink_to(tmp_path / "nowhere.xml")
    (line,) = open_capture(tmp_path).warnings
    assert line.startswith(f"{tmp_path / 'cameras.xml'}: 1 link to nothing")


@pytest.mark.parametrize("spoil", [lambda p: p.mkdir(), lambda p: p.symlink_to("nowhere"), lambda p: p.symlink_to(".")])
def test_settings_that_are_no_file_are_refused(tmp_path, scene, write, spoil):
    write.stokes_transforms(tmp_path, scene)
    spoil(tmp_path / "capture.toml")
    with pytest.raises(UserError, match=r"capture\.toml: is a (folder|link to nothing)"):
        open_capture(tmp_path)


def test_a_name_that_is_no_text_is_refused(tmp_path):
    for name in (b"000.exr", b"\xff\xfe.exr", b"002.exr"):
        (tmp_path / "images").mkdir(exist_ok=True)
        write_rgb(tmp_path / "images" / "new.exr", np.ones((8, 8, 3), np.float32))
        os.rename(tmp_path / "images" / "new.exr", os.path.join(os.fsencode(tmp_path / "images"), name))
    with pytest.raises(UserError, match="no text in UTF-8"):
        open_capture(tmp_path)


def test_maps_are_read_before_the_work(tmp_path, scene, write):
    write.stokes_transforms(tmp_path, scene)
    path = tmp_path / "envmaps" / "sky.exr"
    write_rgb(path, np.ones((8, 16, 3), np.float32))
    RELIGHT.check(open_capture(tmp_path))
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(UserError, match=r"sky\.exr"):
        RELIGHT.check(open_capture(tmp_path))


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_that_no_generator_takes_is_refused(seed):
    with pytest.raises(ValueError, match="seed"):
        TrainParameters(seed=seed)
