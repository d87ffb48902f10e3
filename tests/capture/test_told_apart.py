"""Slips that leave every file readable: each is told in a line that ends with what to check, and sound captures get none."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from pipeline.capture import open_capture
from pipeline.capture.angle_stack.checks import twins
from pipeline.capture.config import RadiometryConfig, load_config
from pipeline.capture.pixels.linear import read_linear
from pipeline.capture.radiometry.stated_encoding import profile_is_curved
from pipeline.capture.recognition.one_framing import what_changes
from pipeline.errors import UserError
from pipeline.geometry.cameras import opengl_from_camera
from stages.calib.decode.light_doubts import FrameRecord, doubt_light, share_below_zero
from synth.ball import behind, codes, picture, ring
from tests.capture.little_captures import write

CAMERAS = ring(4)
PICTURES = [picture(camera) for camera in CAMERAS]
ANGLES = (0, 45, 90, 135)


def table(root: Path, name: str) -> None:
    """transforms.json of the ring in a folder."""
    camera = CAMERAS[0]
    frames = [{"file_path": name.format(i), "transform_matrix": opengl_from_camera(c.world_to_camera).tolist()}
              for i, c in enumerate(CAMERAS)]  # fmt: skip
    facts = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width, "h": camera.height}
    (root / "transforms.json").write_text(json.dumps({**facts, "frames": frames}))


def photographs(root: Path, name: str = "images/{}.png", bits: int = 16) -> None:
    for i, (colour, _, _) in enumerate(PICTURES):
        write(root / name.format(i), codes(colour, bits))


def stack(root: Path, names: str = "images/{}_{:03d}.png", words: tuple = ANGLES) -> None:
    for i, (_, stokes, _) in enumerate(PICTURES):
        for angle, word in zip(ANGLES, words):
            write(root / names.format(i, word), codes(behind(stokes, angle)))


def test_a_jpeg_that_ends_early_is_refused_and_one_with_more_behind_it_is_not(tmp_path):
    path = tmp_path / "images" / "a.jpg"
    write(path, codes(PICTURES[0][0], 8))
    whole = path.read_bytes()
    path.write_bytes(whole + b"more of another program" * 9)
    read_linear(path, RadiometryConfig())
    for share in (0.5, 0.9, 0.99):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(UserError, match=r"a\.jpg: the file is truncated"):
            read_linear(path, RadiometryConfig())


def test_a_link_to_nothing_below_is_named(tmp_path):
    photographs(tmp_path)
    table(tmp_path, "images/{}.png")
    assert open_capture(tmp_path).warnings == ()
    (tmp_path / "extra").mkdir()
    (tmp_path / "extra" / "parallel").symlink_to("/nowhere/parallel")
    (line,) = open_capture(tmp_path).warnings
    assert "1 link to nothing (extra/parallel)" in line


def test_a_stack_without_one_of_its_angles_is_named(tmp_path):
    stack(tmp_path)
    table(tmp_path, "images/{}")
    assert open_capture(tmp_path).warnings == ()
    (tmp_path / "images" / "2_045.png").unlink()
    (line,) = open_capture(tmp_path).warnings
    assert "1 view with fewer angles than the others (2;" in line


def test_one_picture_given_as_two_angles_is_seen(tmp_path):
    stack(tmp_path)
    table(tmp_path, "images/{}")
    shutil.copy(tmp_path / "images" / "1_000.png", tmp_path / "images" / "1_090.png")
    faults = [view.read().faults for view in open_capture(tmp_path).views]
    assert [any("same picture" in fault for fault in found) for found in faults] == [False, True, False, False]
    assert not twins(np.full((4, 3, 5, 3), 0.2, np.float32))


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ({"polarised": True}, []),
        ({"polarised": None}, []),
        ({"polarised": False}, ["no light is polarised"]),
        ({"below_zero": 0.05}, []),
        ({"below_zero": 0.3}, ["30 % as much light lies below 0"]),
        ({"impossible": 40}, ["s1 and s2 are radiance"]),
    ],
)
def test_light_that_cannot_be_is_warned_of(record, words):
    said: list[str] = []
    stage = SimpleNamespace(capture=SimpleNamespace(root=Path("capture")), warn=said.append)
    doubt_light(stage, [FrameRecord({"saturated_fraction": 0.0}, {}, pixels=100, peak=1.0, **record)] * 2)
    assert len(said) == len(words) and all(word in line for word, line in zip(words, said))


def test_light_below_zero_is_counted_by_pixels_and_not_by_colours():
    colour = PICTURES[0][0]
    assert share_below_zero(colour) == 0 and share_below_zero(colour - np.array([0.1, 0, 0], np.float32)) < 0.05
    assert share_below_zero(colour - 0.3) > 0.3
    noise = np.random.default_rng(0).normal(scale=0.002, size=colour.shape)
    assert share_below_zero(np.where(PICTURES[0][2][..., None], colour, noise)) < 0.05


def profile(curve: bytes) -> bytes:
    """The least of an ICC profile: a header, and one tag with a grey tone curve."""
    return bytes(128) + struct.pack(">I4sII", 1, b"kTRC", 144, len(curve)) + curve


def test_a_colour_profile_tells_whether_codes_are_linear():
    table_of = [round(65535 * (k / 1023) ** 2.2) for k in range(1024)]
    curved = [struct.pack(">4sxxxxIH", b"curv", 1, 563), struct.pack(">4sxxxxI1024H", b"curv", 1024, *table_of),
              struct.pack(">4sxxxxHxxIIIII", b"para", 3, 157286, 62119, 3417, 5072, 2651)]  # fmt: skip
    line = struct.pack(">4sxxxxIHHH", b"curv", 3, 0, 32768, 65535)
    parametric = struct.pack(">4sxxxxHxxI", b"para", 0, 65536)
    straight = [struct.pack(">4sxxxxI", b"curv", 0), struct.pack(">4sxxxxIH", b"curv", 1, 256), line, parametric]
    assert all(profile_is_curved(profile(c)) for c in curved)
    assert not any(profile_is_curved(profile(c)) for c in straight) and not profile_is_curved(b"no profile")


@pytest.mark.parametrize(("gamma", "said"), [(563, True), (256, False)])
def test_sixteen_bits_with_a_displays_profile_are_doubted(tmp_path, gamma, said):
    data = profile(struct.pack(">4sxxxxIH", b"curv", 1, gamma))
    (tmp_path / "images").mkdir()
    for i, (colour, _, _) in enumerate(PICTURES):
        tags = [(34675, "B", len(data), data, True)]
        tifffile.imwrite(tmp_path / "images" / f"{i}.tif", codes(colour), photometric="rgb", extratags=tags)
    table(tmp_path, "images/{}.tif")
    assert [("is of a display" in line) for line in open_capture(tmp_path).warnings] == [True] * said
    (tmp_path / "capture.toml").write_text('[radiometry]\nencoding = "srgb"\n')
    assert open_capture(tmp_path).warnings == ()


def test_files_of_eight_bits_among_others_are_named(tmp_path):
    photographs(tmp_path)
    table(tmp_path, "images/{}.png")
    write(tmp_path / "images" / "2.png", codes(PICTURES[2][0], 8))
    (line,) = open_capture(tmp_path).warnings
    assert "1 of 8 bits, 3 of 16 bits; 2.png" in line


def test_codes_that_use_twelve_of_sixteen_bits_are_doubted(tmp_path):
    for i, (colour, _, _) in enumerate(PICTURES):
        write(tmp_path / "images" / f"{i}.png", (colour * 4000).astype(np.uint16))
    table(tmp_path, "images/{}.png")
    (line,) = open_capture(tmp_path).warnings
    assert "no code of these 16-bit files is above 4095" in line and "white_level = 4095" in line
    (tmp_path / "capture.toml").write_text("[radiometry]\nwhite_level = 65535\n")
    assert open_capture(tmp_path).warnings == ()


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [("cx", 0.5, "is a corner"), ("cx", 0, "a corner"), ("cx", 48, "is a corner"), ("fl_x", 2, "not pixels"), ("cx", 2, None)],
)
def test_intrinsics_in_other_units_are_refused(tmp_path, key, value, words):
    photographs(tmp_path)
    table(tmp_path, "images/{}.png")
    facts = json.loads((tmp_path / "transforms.json").read_text())
    twin = {"cx": "cy", "fl_x": "fl_y"}[key]
    (tmp_path / "transforms.json").write_text(json.dumps(facts | {key: value, twin: value}))
    if words is None:
        assert open_capture(tmp_path).warnings == ()
    else:
        with pytest.raises(UserError, match=words):
            open_capture(tmp_path)


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        ('stack.angles_deg = { "_a" = 0, "_b" = 0.785, "_c" = 1.57 }', True),
        ("polarisers.A.angle_deg = 0\npolarisers.B.angle_deg = 2.356", True),
        ("polarisers.A.angle_deg = 0\npolarisers.B.angle_deg = 1", False),
        ("polarisers.A.angle_deg = 0.5\npolarisers.B.angle_deg = 45", False),
    ],
)
def test_angles_in_radians_are_refused(tmp_path, text, refused):
    (tmp_path / "capture.toml").write_text(text + "\n")
    if not refused:
        load_config(tmp_path)
        return
    with pytest.raises(UserError, match="in radians"):
        load_config(tmp_path)


def test_two_views_of_one_pose_are_named(tmp_path):
    photographs(tmp_path)
    table(tmp_path, "images/{}.png")
    facts = json.loads((tmp_path / "transforms.json").read_text())
    facts["frames"][2]["transform_matrix"] = facts["frames"][1]["transform_matrix"]
    (tmp_path / "transforms.json").write_text(json.dumps(facts))
    (line,) = open_capture(tmp_path).warnings
    assert "transforms.json: 1 and 2 have one pose" in line


def test_cameras_and_masks_without_pictures_are_said_to_be_that(tmp_path):
    masks(tmp_path / "masks")
    (tmp_path / "poses_bounds.npy").write_bytes(b"")
    (tmp_path / "images").symlink_to("/nowhere/images")
    with pytest.raises(UserError, match=r"holds masks/, poses_bounds.npy, but no picture of a view \(images is a link to noth"):
        open_capture(tmp_path)


def masks(folder: Path, first: int = 0) -> None:
    for i, (_, _, mask) in enumerate(PICTURES):
        write(folder / f"{i + first}.png", mask.astype(np.uint8) * 255)


@pytest.mark.parametrize("cameras", ["transforms", "colmap"])
def test_a_capture_unpacked_into_a_folder_of_its_own_keeps_its_masks(tmp_path, cameras):
    from stages.calib.poses.write import write_sparse

    home = tmp_path / "bust"
    photographs(home)
    masks(home / "masks")
    if cameras == "transforms":
        table(home, "images/{}.png")
    else:
        write_sparse(home / "sparse" / "0", {f"{i}.png": c for i, c in enumerate(CAMERAS)})
    capture = open_capture(tmp_path)
    assert capture.warnings == () and [v.view for v in capture.views] == ["0", "1", "2", "3"]
    assert isinstance(capture.masks, dict) and sorted(capture.masks) == ["0", "1", "2", "3"]


def test_masks_counted_from_another_number_are_doubted(tmp_path):
    photographs(tmp_path)
    table(tmp_path, "images/{}.png")
    masks(tmp_path / "masks", first=1)
    first, second = open_capture(tmp_path).warnings
    assert "no mask for 1 view (0)" in first and "each mask the next view's" in first and "1 masks belong to no image" in second


@pytest.mark.parametrize("words", [("H", "D", "V", "A"), (1, 2, 3, 4), ("0.00", "0.79", "1.57", "2.36")])
def test_angles_under_names_of_their_own_are_no_views_without_a_word(tmp_path, words):
    stack(tmp_path, "images/{}_{}.png", words)
    found = [line for line in open_capture(tmp_path).warnings if "show one framing (4 of them)" in line]
    assert len(found) == 1 and "[stack.angles_deg]" in found[0]


def test_positions_of_two_turning_axes_are_views(tmp_path):
    for rise in (0.1, 0.6):
        for k, camera in enumerate(ring(36, rises=(rise,))[:4]):
            write(tmp_path / "images" / f"{rise}_{k}.png", codes(picture(camera)[0]))
    assert open_capture(tmp_path).warnings == ()


@pytest.mark.parametrize("step", [5, 30, 90])
def test_exposures_and_angles_stay_in_place_and_views_do_not(tmp_path, step):
    colour, stokes, _ = PICTURES[0]
    sets = {"angles": [behind(stokes, a) for a in ANGLES], "exposures": [np.minimum(colour * g, 1) for g in (0.3, 1, 2)],
            "views": [picture(CAMERAS[0], turn_deg=k * step)[0] for k in range(4)]}  # fmt: skip
    for name, found in sets.items():
        for i, image in enumerate(found):
            write(tmp_path / name / f"{i}.png", codes(image))
    assert [what_changes(sorted((tmp_path / name).iterdir())) for name in sets] == ["gain", "gain", None]


@pytest.mark.parametrize("count", [3, 5])
def test_a_few_pictures_of_one_framing_are_no_views_without_a_word(tmp_path, count):
    for k in range(count):
        write(tmp_path / "one" / "images" / f"{'abcde'[k]}.png", codes(np.minimum(PICTURES[0][0] * (0.3 + 0.2 * k), 1)))
        write(tmp_path / "views" / "images" / f"{'abcde'[k]}.png", codes(picture(CAMERAS[0], turn_deg=20 * k)[0]))
    (line,) = open_capture(tmp_path / "one").warnings
    assert f"its {count} pictures show one framing" in line and line.endswith("check that they are views")
    assert open_capture(tmp_path / "views").warnings == ()
