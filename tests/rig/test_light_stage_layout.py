"""Light-stage folders: which frame is which light, and what is refused."""

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.capture.config import CaptureConfig
from pipeline.capture.light_stage.read_light_table import light_table_file
from pipeline.errors import UserError
from pipeline.formats.images import write_exr, write_mask
from pipeline.geometry.cameras import camera_from_frame
from stages.calib.decode.linear_stage_frames import LinearFrames
from stages.calib.decode.olat_index import _table

CAMERA = """#focal length
200 200
#principal point
10 20
#resolution
20 40
#distortion coeffs
0.4 -0.2 0 0
MATRIX :
1 0 0 0
0 1 0 0
0 0 1 100
0 0 0 1
"""


def build(root, lights=5, first=0, extra=0, size=(20, 10)):
    frame = {c: np.full(size, 0.5, np.float32) for c in "RGB"}
    for name in ("cross", "parallel"):
        for k in range(first - min(first, 2), first + lights + extra):
            write_exr(root / "cam00" / name / f"{k:06d}.exr", frame, half=True)
    write_mask(root / "cam00" / "mask.png", np.ones(size, bool))
    (root / "cameras").mkdir()
    (root / "cameras" / "camera00.txt").write_text(CAMERA)
    rows = "\n".join(f"{k},{np.cos(k)},{np.sin(k)},1" for k in range(lights))
    (root / "lights.csv").write_text("index,x,y,z\n" + rows + "\n")
    return root


def test_frames_from_zero_are_the_lights(tmp_path):
    camera = open_capture(build(tmp_path)).light_stage.cameras["cam00"]
    assert [p.stem for p in camera.cross] == [f"{k:06d}" for k in range(5)]


def test_two_leading_frames_under_all_lights_are_set_aside(tmp_path):
    capture = open_capture(build(tmp_path, first=2, extra=2))
    camera = capture.light_stage.cameras["cam00"]
    assert [p.stem for p in camera.parallel] == [f"{k:06d}" for k in range(2, 7)]
    assert [p.stem for p in camera.full_light] == ["000000", "000001", "000007", "000008"]


def test_a_smaller_image_is_the_full_frame_scaled_by_height_and_centred(tmp_path):
    camera = open_capture(build(tmp_path)).light_stage.cameras["cam00"].camera
    assert (camera.fx, camera.cx, camera.cy) == (100.0, 5.0, 10.0)
    assert np.allclose(camera.centre, [0, 0, 100]) and camera.distortion == ()


def test_distortion_is_applied_only_on_request(tmp_path):
    build(tmp_path)
    (tmp_path / "capture.toml").write_text("[olat]\ndistortion = true\n")
    stage = open_capture(tmp_path).light_stage
    assert stage.cameras["cam00"].camera.distortion[0] == 0.4
    entry = _table(stage, tmp_path, LinearFrames({}, None, 0.0, 0, {}, {}))["cameras"]["cam00"]["camera"]
    read = camera_from_frame({"file_path": "cam00", **entry}, {}, tmp_path / "olat.json")  # as the olat stage does
    assert read.distortion == (0.4, -0.2, 0.0, 0.0)
    text = (tmp_path / "cameras" / "camera00.txt").read_text()
    (tmp_path / "cameras" / "camera00.txt").write_text(text.replace("0.4 -0.2 0 0", "-80 0 0 0"))
    with pytest.raises(UserError, match=r"camera00\.txt.*folds"):
        open_capture(tmp_path)


def test_a_table_of_another_length_is_refused(tmp_path):
    build(tmp_path)
    (tmp_path / "lights.csv").write_text("index,x,y,z\n0,1,0,0\n1,0,1,0\n")
    with pytest.raises(UserError, match="lists 2 lights"):
        open_capture(tmp_path)


def test_missing_frames_are_named(tmp_path):
    build(tmp_path)
    (tmp_path / "cam00" / "cross" / "000002.exr").unlink()
    with pytest.raises(UserError, match="lacks frame 2"):
        open_capture(tmp_path)


@pytest.mark.parametrize("victim", ["cameras/camera00.txt", "lights.csv"])
def test_missing_parts_are_refused_by_path(tmp_path, victim):
    import shutil

    build(tmp_path)
    path = tmp_path / victim
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(UserError):
        open_capture(tmp_path)


def test_a_mask_of_another_size_is_refused(tmp_path):
    build(tmp_path)
    write_mask(tmp_path / "cam00" / "mask.png", np.ones((4, 4), bool))
    with pytest.raises(UserError, match="the frames"):
        open_capture(tmp_path)


def test_an_empty_frame_is_refused(tmp_path):
    build(tmp_path)
    (tmp_path / "cam00" / "cross" / "000001.exr").write_bytes(b"")
    with pytest.raises(UserError, match="0 bytes"):
        open_capture(tmp_path)


def test_a_camera_matrix_that_is_no_rotation_is_refused(tmp_path):
    build(tmp_path)
    path = tmp_path / "cameras" / "camera00.txt"
    path.write_text(path.read_text().replace("1 0 0 0\n0 1", "2 0 0 0\n0 1"))
    with pytest.raises(UserError, match="no rotation"):
        open_capture(tmp_path)


@pytest.mark.parametrize("name", ["Lights.csv", "LSX3_light_positions.txt", "dome.lp", "light_directions.txt"])
def test_every_kind_of_light_table_is_found_by_its_file(tmp_path, name):
    assert light_table_file(tmp_path, CaptureConfig()) is None
    (tmp_path / name).write_text("1\na.png 0 0 1\n")
    assert light_table_file(tmp_path, CaptureConfig()) == tmp_path / name
