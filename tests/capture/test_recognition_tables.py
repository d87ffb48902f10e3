"""capture.toml against the capture: a table that matches nothing, or not everything, is an error that names what it missed."""

import pytest

from pipeline.capture import open_capture
from pipeline.errors import UserError
from synth import ball

VIEWS = 3


@pytest.fixture
def root(tmp_path):
    """Photographs named a_0 .. c_2, of three views under three letters."""
    for i, camera in enumerate(ball.ring(VIEWS)):
        stokes = ball.picture(camera)[1]
        for letter, angle in zip("abc", (0, 60, 120)):
            ball.write(tmp_path / f"images/v{i}_{letter}.png", ball.codes(ball.behind(stokes, angle)))
    return tmp_path


def refused(root, toml, *words):
    (root / "capture.toml").write_text(toml)
    with pytest.raises(UserError) as caught:
        open_capture(root)
    line = str(caught.value)
    assert caught.value.remedy and "\n" not in line and "capture.toml" in line
    for word in words:
        assert word in line, line


ANGLES = "[stack.angles_deg]\n_a = 0\n_b = 60\n_c = 120\n"


def test_told_angles_that_fit_everything_are_used(root):
    (root / "capture.toml").write_text(ANGLES)
    capture = open_capture(root)
    assert capture.layout == "angle_stack" and len(capture.views) == VIEWS and not capture.warnings


def test_told_angles_that_miss_files_name_them(root):
    ball.write(root / "images/IMG_7.png", ball.codes(ball.picture(ball.ring(1)[0])[0]))
    refused(root, ANGLES, "1 of 10 images", "IMG_7.png")


def test_told_angles_that_fit_nothing_name_the_endings(root):
    refused(root, "[stack.angles_deg]\n_x = 0\n_y = 60\n_z = 120\n", "none of the 9 images", "'_x'", "v0_a.png")


def test_an_ending_that_no_file_has_is_named(root):
    refused(root, ANGLES + "_d = 150\n", "no image ends in '_d'")


def test_told_angles_behind_a_table_of_cameras_are_held_against_the_files(root):
    ball.save(root / "transforms.json", ball.transforms(ball.ring(VIEWS), [f"images/v{i}_a.png" for i in range(VIEWS)]))
    refused(root, "[stack.angles_deg]\n_x = 0\n_y = 60\n_z = 120\n", "none of the 9 images")
    (root / "capture.toml").write_text(ANGLES)
    assert open_capture(root).layout == "stack_transforms"


def test_a_preview_is_no_miss_of_told_angles(root):
    ball.write(root / "images/preview.png", ball.codes(ball.picture(ball.ring(1)[0])[0]))
    (root / "capture.toml").write_text(ANGLES)
    assert "preview.png" in open_capture(root).warnings[0]


def test_mosaics_told_of_colour_pictures(root):
    refused(root, '[mosaic]\ncolour = "mono"\n', "[mosaic]", "9 of 9 images", "differ")


def test_mosaics_told_that_miss_some_files(tmp_path):
    for i, camera in enumerate(ball.ring(VIEWS)):
        ball.write(tmp_path / f"images/{i}.png", ball.codes(ball.mosaic(ball.picture(camera)[1])))
    ball.write(tmp_path / "images/zz.png", ball.codes(ball.picture(ball.ring(1)[0])[0]))
    refused(tmp_path, '[mosaic]\ncolour = "mono"\n', "1 of 4 images (zz.png)")


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ("[radiometry]\nexposure_s = { v0_a = 0.1, v9_q = 0.2 }\n", ["v9_q", "the names are v0_a"]),
        ('[poses]\nscale_pair = ["v0_a", "v5_a"]\nscale_distance = 1\n', ["scale_pair", "v5_a", "did you mean v"]),
        ("[stack]\nclockwise = true\n", ["[stack]", "photographs"]),
        ('[olat]\nlights = "rig.csv"\n', ["[olat]", "no light stage"]),
        ("[polarisers.left]\nangle_deg = 3\n", ["polarisers.left"]),
        ('clean_plate = "empty"\n', ["clean_plate", "empty"]),
    ],
)
def test_tables_that_match_nothing_are_named(root, toml, words):
    refused(root, toml, *words)


@pytest.mark.parametrize(
    "toml",
    [
        "[radiometry]\nexposure_s = { v0_a = 0.1, v1_b = 0.2 }\n",
        '[poses]\nscale_pair = ["v0_a", "v1_a"]\nscale_distance = 1\n',
    ],
)
def test_tables_that_match_are_taken(root, toml):
    (root / "capture.toml").write_text(toml)
    assert len(open_capture(root).views) == 3 * VIEWS
