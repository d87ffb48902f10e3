"""Files among the images that are no views are left out and named; a set that is all of one kind loses nothing."""

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.capture.recognition.stray_files import sort_out
from pipeline.errors import UserError
from synth import ball

VIEWS = 4


@pytest.fixture(scope="module")
def pictures():
    """[(colour, stokes, mask)] of a few views."""
    return [ball.picture(camera) for camera in ball.ring(VIEWS)]


def stacks(root, pictures, name="images/{i:03d}_{a:03d}.png"):
    for i, (_, stokes, _) in enumerate(pictures):
        for a in (0, 45, 90, 135):
            ball.write(root / name.format(i=i, a=a), ball.codes(ball.behind(stokes, a)))


def mosaics(root, pictures, name="images/{i:03d}.png"):
    for i, (_, stokes, _) in enumerate(pictures):
        ball.write(root / name.format(i=i), ball.codes(ball.mosaic(stokes)))


def photographs(root, pictures, name="images/{i:03d}.png"):
    for i, (colour, _, _) in enumerate(pictures):
        ball.write(root / name.format(i=i), ball.codes(colour))


def said(capture):
    return "\n".join(capture.warnings)


STRAYS = {
    "a preview": ["preview.jpg"],
    "a thumbnail a view": [f"{i:03d}_thumb.jpg" for i in range(VIEWS)],
    "products": [f"{i:03d}_{p}.png" for i in range(VIEWS) for p in ("dolp", "aolp", "s0", "S1")],
    "unpolarised pictures": [f"{i:03d}_unpol.png" for i in range(VIEWS)],
    "camel case": ["DoLP_000.png", "AoLP_000.png"],
    "boards": [f"checkerboard_{i}.png" for i in range(3)],
    "a folder of thumbnails": [f"thumbs/{i:03d}.png" for i in range(VIEWS)],
    "a mask": ["mask.png"],
    "truth": ["Normal_gt.png"],
    "a dark frame": ["dark_frame.png"],
}


@pytest.mark.parametrize("kind", [stacks, mosaics, photographs])
@pytest.mark.parametrize("what", STRAYS)
def test_files_that_are_no_views_are_left_out_and_named(kind, what, pictures, tmp_path):
    kind(tmp_path, pictures)
    for name in STRAYS[what]:
        ball.write(tmp_path / "images" / name, ball.codes(pictures[0][0], 8))
    capture = open_capture(tmp_path)
    assert capture.layout == {stacks: "angle_stack", mosaics: "mosaic", photographs: "photographs"}[kind]
    assert [v.view for v in capture.views] == [f"{i:03d}" for i in range(VIEWS)]
    assert "left out" in said(capture) and any(name.rsplit("/", 1)[-1] in said(capture) for name in STRAYS[what])


@pytest.mark.parametrize("kind", [stacks, mosaics, photographs])
def test_a_sound_capture_has_no_warning(kind, pictures, tmp_path):
    kind(tmp_path, pictures)
    assert open_capture(tmp_path).warnings == ()


@pytest.mark.parametrize("name", ["mask_{i:03d}.png", "gt/{i:03d}.png", "calibration_{i:03d}.png", "dark vase {i:03d}.png"])
def test_a_set_of_one_name_is_kept_whatever_it_is_called(name, pictures, tmp_path):
    photographs(tmp_path, pictures, "images/" + name)
    capture = open_capture(tmp_path)
    assert len(capture.views) == VIEWS and not capture.warnings


def test_words_that_name_objects_leave_large_groups_alone(tmp_path):
    paths = [tmp_path / f"{side}_{i:02d}.jpg" for side in ("dark", "bright") for i in range(10)]
    assert not sort_out(paths, tmp_path).left_out
    assert len(sort_out([*paths[:1], *paths[10:]], tmp_path).kept) == 10


def test_strays_without_a_telling_name_fit_no_stack(pictures, tmp_path):
    stacks(tmp_path, pictures)
    for name in ("me.jpg", "IMG_2034.jpg"):
        ball.write(tmp_path / "images" / name, ball.codes(pictures[0][0], 8))
    capture = open_capture(tmp_path)
    assert capture.layout == "angle_stack" and len(capture.views) == VIEWS
    assert "IMG_2034.jpg, me.jpg: part of no angle stack" in said(capture)


def test_half_stacks_half_something_else_is_refused(pictures, tmp_path):
    stacks(tmp_path, pictures)
    for i in range(6):
        ball.write(tmp_path / "images" / f"{chr(97 + i)}.jpg", ball.codes(pictures[0][0], 8))
    with pytest.raises(UserError, match=r"16 files make angle stacks, 6 do not \(a\.jpg"):
        open_capture(tmp_path)


def test_colour_pictures_among_mosaics_are_left_out_by_their_channels(pictures, tmp_path):
    mosaics(tmp_path, pictures)
    for i in range(2):
        ball.write(tmp_path / "images" / f"zz_{i}.jpg", ball.codes(pictures[i][0], 8))
    capture = open_capture(tmp_path)
    assert capture.layout == "mosaic" and len(capture.views) == VIEWS and "zz_0.jpg, zz_1.jpg" in said(capture)


def test_grey_pictures_among_mosaics_are_left_out_by_their_pixels(pictures, tmp_path):
    mosaics(tmp_path, pictures)
    for i in range(2):
        ball.write(tmp_path / "images" / f"grey_{i}.png", ball.codes(pictures[i][0].mean(-1)))
    capture = open_capture(tmp_path)
    assert capture.layout == "mosaic" and len(capture.views) == VIEWS and "grey_0.png, grey_1.png" in said(capture)


@pytest.mark.parametrize("specified", [True, False])
@pytest.mark.parametrize("shape", ["three channels", "four channels", "grey and alpha", "8 bits"])
def test_equal_channels_of_a_mosaic_are_one(specified, shape, pictures, tmp_path):
    for i, (_, stokes, _) in enumerate(pictures):
        grey = ball.codes(ball.mosaic(stokes), 8 if shape == "8 bits" else 16)
        opaque = np.full_like(grey, np.iinfo(grey.dtype).max)
        parts = {"four channels": [grey] * 3 + [opaque], "grey and alpha": [grey, opaque]}.get(shape, [grey] * 3)
        ball.write(tmp_path / "images" / f"{i}.png", np.stack(parts, -1))
    if specified:
        (tmp_path / "capture.toml").write_text('[mosaic]\ncolour = "mono"\n')
    capture = open_capture(tmp_path)
    assert capture.polarisation == "stokes"
    truth = pictures[0][1].mean(-1)
    decoded = capture.views[0].read().stokes[..., 0]
    assert np.median(np.abs(decoded[:, :, 0] - truth[:, :, 0])) < 0.01


def test_the_cameras_own_jpegs_of_raw_files_are_left_out(tmp_path):
    for folder in ("", "jpg/"):
        paths = [tmp_path / f"IMG_{i}.CR2" for i in range(3)] + [tmp_path / f"{folder}IMG_{i}.JPG" for i in range(3)]
        found = sort_out(paths, tmp_path)
        assert [p.suffix for p in found.kept] == [".CR2"] * 3
        assert "IMG_0.JPG" in found.warnings()[0] and "raw files" in found.warnings()[0]


def test_raw_files_in_a_folder_of_their_own_are_named(pictures, tmp_path):
    photographs(tmp_path, pictures, "images/IMG_{i}.jpg")
    for i in range(VIEWS):
        (tmp_path / "raw").mkdir(exist_ok=True)
        (tmp_path / f"raw/IMG_{i}.DNG").write_bytes(b"x")
    capture = open_capture(tmp_path)
    assert len(capture.views) == VIEWS and "raw: 4 camera raw files" in said(capture)


def test_smaller_copies_are_left_out_and_other_views_are_not(pictures, tmp_path):
    photographs(tmp_path, pictures, "images/IMG_{i}.png")
    colour = ball.codes(pictures[0][0])
    ball.write(tmp_path / "images" / "IMG_1_web.png", colour[::2, ::2])
    ball.write(tmp_path / "images" / "IMG_2_left.png", colour)
    capture = open_capture(tmp_path)
    assert [v.view for v in capture.views] == ["IMG_0", "IMG_1", "IMG_2", "IMG_2_left", "IMG_3"]
    assert "IMG_1_web.png: smaller copies" in said(capture)


def test_a_table_that_names_its_images_decides(pictures, tmp_path):
    cameras = ball.ring(VIEWS)
    photographs(tmp_path, pictures, "images/calib_{i:03d}.png")
    photographs(tmp_path, pictures, "images/other_{i:03d}.png")
    ball.save(tmp_path / "transforms.json", ball.transforms(cameras, [f"images/calib_{i:03d}.png" for i in range(VIEWS)]))
    capture = open_capture(tmp_path)
    assert [v.view for v in capture.views] == [f"calib_{i:03d}" for i in range(VIEWS)] and "no camera for 4 images" in said(
        capture
    )


def test_one_odd_file_does_not_turn_stacks_behind_a_table_into_photographs(pictures, tmp_path):
    stacks(tmp_path, pictures)
    ball.write(tmp_path / "images/preview.jpg", ball.codes(pictures[0][0], 8))
    ball.save(
        tmp_path / "transforms.json", ball.transforms(ball.ring(VIEWS), [f"images/{i:03d}_000.png" for i in range(VIEWS)])
    )
    capture = open_capture(tmp_path)
    assert capture.layout == "stack_transforms" and len(capture.views) == VIEWS and "preview.jpg" in said(capture)


def test_resource_files_of_macos_are_left_out_everywhere(scene, write, tmp_path):
    junk = b"\0\5\x16\7\0\2\0\0Mac OS X" + bytes(80)
    for layout, places in {
        "stokes_transforms": ["images/._0000.exr", "envmaps/._a.hdr"],
        "pandora": ["images_stokes/._0000_s0.hdr", "masks/._0000.png"],
        "smvp3d": ["s0/._0000.npy"],
        "rmvp3d": ["images_stokes/._0000.npz"],
        "angle_stack": ["images/._0000_000.exr", "._0000.png"],
    }.items():
        root = tmp_path / layout
        root.mkdir()
        getattr(write, layout)(root, scene)
        for place in places:
            (root / place).parent.mkdir(exist_ok=True)
            (root / place).write_bytes(junk)
        capture = open_capture(root)
        assert capture.layout == layout and len(capture.views) == len(scene.names)
        assert not any("._" in p.name for p in capture.files)
        assert "._" in said(capture) or not any(p.startswith(("images/", "images_stokes/")) for p in places)


@pytest.mark.parametrize(
    "name", ["images/{}.psd", "images/{}.avif", "images/{}.bin", "images/{}.jp2", "{}.avif", "images/{}.mat"]
)
def test_pictures_that_nobody_reads_are_named_in_one_line(name, tmp_path):
    for i in range(3):
        path = tmp_path / name.format(i)
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x" * 100)
    with pytest.raises(UserError) as caught:
        open_capture(tmp_path)
    assert str(caught.value).startswith(str(tmp_path / name.format(0))) and caught.value.remedy
    assert "no known capture layout" not in str(caught.value)
