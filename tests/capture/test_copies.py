"""One picture under two names is named, for views and for lights; black frames, and pictures that noise sets apart, are not."""

from __future__ import annotations

import shutil

import numpy as np

from pipeline.capture import open_capture
from pipeline.capture.recognition.copies import PIECE, copies
from synth.ball import light_directions, lights_csv, ring, save, transforms, write_stage
from tests.capture.little_captures import codes, stokes, write

NAMES = [f"images/{k}.png" for k in range(4)]


def views(root):
    for k, name in enumerate(NAMES):
        write(root / name, codes(stokes(k)[:, :, 0]))
    save(root / "transforms.json", transforms(ring(4, 48), NAMES))


def test_one_picture_as_two_views_is_named(tmp_path):
    views(tmp_path)
    assert open_capture(tmp_path).warnings == ()
    shutil.copy(tmp_path / NAMES[1], tmp_path / NAMES[3])
    (line,) = open_capture(tmp_path).warnings
    assert "is a copy of another in every byte (images/1.png and images/3.png)" in line and line.endswith("picture is missing")


def test_one_frame_as_two_lights_is_named_once_a_pass_and_black_frames_are_not(tmp_path):
    write_stage(tmp_path)
    (tmp_path / "lights.csv").write_text(lights_csv(light_directions(12)))
    black = np.zeros((16, 16, 3), np.float16)
    for number in ("000000", "000001"):
        for which in ("cross", "parallel"):
            write(tmp_path / "cam00" / which / f"{number}.exr", black)
    assert not [line for line in open_capture(tmp_path).warnings if "in every byte" in line]
    for which in ("cross", "parallel"):
        shutil.copy(tmp_path / "cam00" / which / "000007.exr", tmp_path / "cam00" / which / "000008.exr")
    (line,) = [line for line in open_capture(tmp_path).warnings if "in every byte" in line]
    assert line.count("000007.exr and") == 2 and "which two lights never are" in line


def test_files_are_compared_whole(tmp_path):
    rng = np.random.default_rng(0)
    data = rng.integers(0, 256, 10 * PIECE, np.uint8)
    for name, change in (("a", None), ("b", None), ("c", 3 * PIECE), ("d", 0)):
        other = data.copy()
        if change is not None:
            other[change] ^= 1
        (tmp_path / name).write_bytes(other.tobytes())
    found = copies([*sorted(tmp_path.iterdir()), tmp_path / "missing"])
    assert found == [(tmp_path / "a", tmp_path / "b")]
