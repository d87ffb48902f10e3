"""Cameras that lie beside the images are used, in every program's format; what is not read is named with the way out."""

import shutil
import struct
from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.errors import UserError
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, opengl_from_camera
from stages.calib.poses.write import quaternion, write_sparse
from synth import ball

VIEWS = 6


@pytest.fixture(scope="module")
def views():
    """[(camera, codes)]"""
    return [(camera, ball.codes(ball.picture(camera)[0])) for camera in ball.ring(VIEWS)]


def images(root, views, name="images/{:03d}.png"):
    for i, (_, pixels) in enumerate(views):
        ball.write(root / name.format(i), pixels)


def same(capture, views, names=None, tolerance=1e-6):
    """The capture's cameras are those of the views, in order."""
    names = names or [f"{i:03d}" for i in range(len(views))]
    assert sorted(capture.cameras) == sorted(names)
    for name, (truth, _) in zip(names, views):
        camera = capture.cameras[name]
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=tolerance)
        np.testing.assert_allclose(camera.intrinsics, truth.intrinsics, atol=tolerance * 100)
        assert (camera.width, camera.height) == (truth.width, truth.height)


# ---- writers of other programs' formats ------------------------------------------------------------------------------
def metashape(root, views, folder="", component=None, distortion=(0, 0, 0, 0), turn=None, scale=1.0, shift=(0, 0, 0)):
    """cameras.xml; with a component the poses are written in a chunk of another place, turn and size."""
    place = np.eye(4)
    if component:
        place[:3, :3], place[:3, 3] = scale * turn, shift
    rows = []
    for i, (camera, _) in enumerate(views):
        pose = np.linalg.inv(camera.world_to_camera)
        local = np.eye(4)
        local[:3, :3] = (place[:3, :3] / scale).T @ pose[:3, :3]
        local[:3, 3] = np.linalg.solve(place[:3, :3], pose[:3, 3] - place[:3, 3])
        text = " ".join(repr(float(x)) for x in local.ravel())
        own = ' component_id="0"' if component else ""
        rows.append(f'<camera id="{i}" sensor_id="0"{own} label="{i:03d}"><transform>{text}</transform></camera>')
    rows.append('<camera id="99" sensor_id="0" label="099"/>')
    c = views[0][0]
    numbers = [" ".join(repr(float(x)) for x in np.ravel(v)) for v in (place[:3, :3] / scale, place[:3, 3], scale)]
    places = (
        f'<components><component id="0"><transform><rotation>{numbers[0]}</rotation><translation>{numbers[1]}</translation>'
        f"<scale>{numbers[2]}</scale></transform></component></components>"
    )
    k1, k2, p1, p2 = distortion
    (root / folder).mkdir(exist_ok=True)
    (root / folder / "cameras.xml").write_text(
        f'<?xml version="1.0"?>\n<document version="2.0.0"><chunk label="C" enabled="true"><sensors next_id="1">'
        f'<sensor id="0" label="x" type="frame"><resolution width="{c.width}" height="{c.height}"/>'
        f'<calibration type="frame" class="adjusted"><resolution width="{c.width}" height="{c.height}"/><f>{c.fy!r}</f>'
        f"<b1>{c.fx - c.fy!r}</b1><cx>{c.cx - c.width / 2!r}</cx><cy>{c.cy - c.height / 2!r}</cy><k1>{k1}</k1><k2>{k2}</k2>"
        f"<p1>{p1}</p1><p2>{p2}</p2></calibration></sensor></sensors>{places if component else ''}"
        f"<cameras>{''.join(rows)}</cameras></chunk></document>"
    )


def middlebury(root, views, folder=""):
    (root / folder).mkdir(exist_ok=True)
    lines = [str(len(views))]
    for i, (c, _) in enumerate(views):
        numbers = [*c.intrinsics.ravel(), *c.world_to_camera[:3, :3].ravel(), *c.world_to_camera[:3, 3]]
        lines.append(f"{i:03d}.png " + " ".join(repr(float(x)) for x in numbers))
    (root / folder / "ball_par.txt").write_text("\n".join(lines) + "\n")


def bundler(root, views, folder="", listed=True):
    (root / folder).mkdir(exist_ok=True)
    lines = ["# Bundle file v0.3", f"{len(views)} 0"]
    for c, _ in views:
        pose = OPENGL_FROM_OPENCV @ c.world_to_camera
        lines += [f"{c.fx!r} 0 0", *(" ".join(repr(float(x)) for x in row) for row in pose[:3, :3])]
        lines.append(" ".join(repr(float(x)) for x in pose[:3, 3]))
    (root / folder / "bundle.out").write_text("\n".join(lines) + "\n")
    if listed:
        (root / folder / "list.txt").write_text("".join(f"images/{i:03d}.jpg 0 {c.fx}\n" for i, (c, _) in enumerate(views)))


def llff(root, views, folder=""):
    (root / folder).mkdir(exist_ok=True)
    rows = []
    for c, _ in views:
        m = opengl_from_camera(c.world_to_camera)
        block = np.stack([-m[:3, 1], m[:3, 0], m[:3, 2], m[:3, 3], [c.height, c.width, c.fx]], axis=1)
        rows.append(np.concatenate([block.ravel(), [1, 9]]))
    np.save(root / folder / "poses_bounds.npy", np.array(rows))


def neus(root, views, folder="", name="cameras_sphere.npz"):
    (root / folder).mkdir(exist_ok=True)
    table = {}
    for i, (c, _) in enumerate(views):
        matrix = np.eye(4)
        matrix[:3] = c.intrinsics @ c.world_to_camera[:3]
        table[f"world_mat_{i}"], table[f"scale_mat_{i}"] = matrix, np.diag([2.0, 2, 2, 1])
    np.savez(root / folder / name, **table)


def colmap(folder, views, names="{:03d}.png"):
    write_sparse(folder, {names.format(i): c for i, (c, _) in enumerate(views)})


WRITERS = {"metashape": metashape, "middlebury": middlebury, "bundler": bundler, "llff": llff, "neus": neus}


@pytest.mark.parametrize("folder", ["", "images", "calibration"])
@pytest.mark.parametrize("program", WRITERS)
def test_cameras_of_other_programs_come_back_as_they_were_written(program, folder, views, tmp_path):
    images(tmp_path, views)
    WRITERS[program](tmp_path, views, folder)
    capture = open_capture(tmp_path)
    same(capture, views)
    assert any(fact.startswith("cameras: ") for fact in capture.facts)
    assert any(p.parent == tmp_path / folder and p.suffix in (".xml", ".txt", ".out", ".npy", ".npz") for p in capture.files)


def test_neus_with_image_and_mask_folders(views, tmp_path):
    images(tmp_path, views, "image/{:03d}.png")
    for i, camera in enumerate(ball.ring(VIEWS)):
        ball.write(tmp_path / f"mask/{i:03d}.png", ball.picture(camera)[2].astype(np.uint8) * np.uint8(255))
    neus(tmp_path, views)
    neus(tmp_path, views, name="cameras_large.npz")
    capture = open_capture(tmp_path)
    same(capture, views)
    assert len(capture.masks) == VIEWS and not capture.warnings


def test_metashape_in_another_place_with_a_lens(views, tmp_path):
    images(tmp_path, views)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    metashape(tmp_path, views, component=True, distortion=(0.1, -0.02, 3e-3, 1e-3), turn=turn, scale=3.7, shift=(400, -20, 7))
    capture = open_capture(tmp_path)
    same(capture, views)
    assert capture.cameras["000"].distortion == (0.1, -0.02, 1e-3, 3e-3)  # OpenCV's p1 is Metashape's p2
    assert "not aligned by Metashape (099)" in capture.warnings[0]


def test_metashape_with_a_term_that_is_not_read_is_refused(views, tmp_path):
    images(tmp_path, views)
    metashape(tmp_path, views)
    path = tmp_path / "cameras.xml"
    path.write_text(path.read_text().replace("<p1>", "<k4>9</k4><p1>"))
    with pytest.raises(UserError, match=r"cameras\.xml: its lens has k4"):
        open_capture(tmp_path)


def test_metashape_components_without_a_common_world_are_not_mixed(views, tmp_path):
    """A component that is neither georeferenced nor merged has a world of its own."""
    images(tmp_path, views)
    metashape(tmp_path, views, component=True, turn=np.eye(3)[[1, 2, 0]], scale=2.0, shift=(1, 2, 3))
    path = tmp_path / "cameras.xml"
    text = path.read_text().replace("</components>", '<component id="1"/></components>')
    for i in (0, 4):
        entry = f'<camera id="{i}" sensor_id="0" component_id='
        text = text.replace(f'{entry}"0"', f'{entry}"1"')
    path.write_text(text.replace("</chunk>", "</chunk><chunk><cameras/></chunk>"))
    capture = open_capture(tmp_path)
    kept = [1, 2, 3, 5]
    same(capture, [views[i] for i in kept], [f"{i:03d}" for i in kept])
    told = "\n".join(capture.warnings)
    assert "2 photographs of other components (000, 004)" in told and "the largest of its 2 chunks" in told


def test_metashape_with_a_third_radial_term(views, tmp_path):
    images(tmp_path, views)
    metashape(tmp_path, views, distortion=(0.1, -0.02, 3e-3, 1e-3))
    path = tmp_path / "cameras.xml"
    path.write_text(path.read_text().replace("<p1>", "<k3>0.9</k3><p1>"))
    camera = open_capture(tmp_path).cameras["000"]
    assert (camera.lens, camera.distortion) == ("FULL_OPENCV", (0.1, -0.02, 1e-3, 3e-3, 0.9, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("program", WRITERS)
def test_what_can_be_no_camera_is_refused_on_its_own_file(views, tmp_path, program):
    images(tmp_path, views)
    WRITERS[program](tmp_path, [(replace(c, fx=0.1, fy=0.1), p) for c, p in views])
    with pytest.raises(UserError, match=r"\.(xml|txt|out|npy|npz): (image .*000|camera 0|world_mat_0).* not pixels of a 48x48"):
        open_capture(tmp_path)


@pytest.mark.parametrize("program", [p for p in WRITERS if p != "neus"])
def test_a_pose_that_is_no_rotation_is_refused_on_its_own_file(views, tmp_path, program):
    images(tmp_path, views)
    squeeze = np.diag([1.2, 1, 1, 1])
    WRITERS[program](tmp_path, [(replace(c, world_to_camera=squeeze @ c.world_to_camera), p) for c, p in views])
    with pytest.raises(UserError, match=r"\.(xml|txt|out|npy): (image .*000|camera 0).*no rotation"):
        open_capture(tmp_path)


def test_bundler_without_a_list_goes_by_order(views, tmp_path):
    images(tmp_path, views)
    bundler(tmp_path, views, listed=False)
    same(open_capture(tmp_path), views)


def test_cameras_by_order_that_do_not_count_the_images_are_refused(views, tmp_path):
    images(tmp_path, views)
    llff(tmp_path, views[:-1])
    with pytest.raises(UserError, match=r"poses_bounds\.npy: holds 5 cameras for 6 views"):
        open_capture(tmp_path)


def test_llff_for_smaller_images(views, tmp_path):
    for i, (_, pixels) in enumerate(views):
        ball.write(tmp_path / f"images/{i:03d}.png", pixels[::2, ::2])
    llff(tmp_path, views)
    assert open_capture(tmp_path).cameras["000"].fx == pytest.approx(ball.FOCAL / 2)


@pytest.mark.parametrize("name", ["cameras.xml", "x_par.txt", "bundle.out", "poses_bounds.npy", "cameras_sphere.npz"])
def test_damaged_camera_files_are_one_line_that_names_them(name, views, tmp_path):
    images(tmp_path, views)
    (tmp_path / name).write_bytes(b"<document><chunk></chunk>" if name.endswith("xml") else b"junk \x00 1 2")
    with pytest.raises(UserError) as caught:
        open_capture(tmp_path)
    assert str(caught.value).startswith(str(tmp_path / name)) and caught.value.remedy


@pytest.mark.parametrize("name", ["scene.psx", "model.nvm", "sfm_data.json", "reconstruction.json", "00_cam.txt"])
def test_camera_files_that_are_not_read_are_named_with_the_way_out(name, views, tmp_path):
    images(tmp_path, views)
    (tmp_path / name).write_text("{}")
    capture = open_capture(tmp_path)
    assert capture.cameras is None and str(tmp_path / name) in capture.warnings[0] and "to use it" in capture.warnings[0]


# ---- transforms.json -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "template",
    [
        "images\\{:03d}.png", ".\\images\\{:03d}.png", "C:\\me\\scene\\images\\{:03d}.png", "/home/me/scene/images/{:03d}.png",
        "../other/{:03d}.png", "images/{:03d}", "./images/{:03d}", "D:/x/{:03d}.JPG", "images/{:03d}.jpg", "{:03d}",
    ],
)  # fmt: skip
def test_paths_of_other_machines_are_matched_by_name(template, views, tmp_path):
    images(tmp_path, views)
    ball.save(tmp_path / "transforms.json", ball.transforms([c for c, _ in views], [template.format(i) for i in range(VIEWS)]))
    capture = open_capture(tmp_path)
    same(capture, views)
    assert not capture.warnings


def test_a_table_whose_images_are_not_here_is_one_line(views, tmp_path):
    ball.save(tmp_path / "transforms.json", ball.transforms([c for c, _ in views], [f"C:\\a\\{i}.png" for i in range(VIEWS)]))
    for _ in range(2):
        with pytest.raises(UserError, match=r"transforms\.json: none of its 6 images is there \(first: C:"):
            open_capture(tmp_path)
        ball.write(tmp_path / "images/other.png", views[0][1])


@pytest.mark.parametrize("beside", ["masks", "gt/normals", "depth", "previews", "albedo_maps", "envmaps"])
def test_pictures_named_like_views_do_not_stand_in_for_views_that_are_gone(beside, views, tmp_path):
    root, elsewhere = tmp_path / "capture", tmp_path / "elsewhere"
    images(root, views, beside + "/{:03d}.png")
    elsewhere.mkdir()
    ball.save(root / "transforms.json", ball.transforms([c for c, _ in views], [f"images/{i:03d}.png" for i in range(VIEWS)]))
    for _ in range(2):
        with pytest.raises(UserError, match=r"none of its 6 images is there \(first: images/000"):
            open_capture(root)
        (root / "images").symlink_to(elsewhere) if not (root / "images").is_symlink() else None


def test_a_capture_of_maps_alone_is_doubted(views, tmp_path):
    images(tmp_path, views, "depth/{:03d}.png")
    assert any("holds no photographs" in text and "check" in text for text in open_capture(tmp_path).warnings)


def test_one_missing_image_is_not_matched_with_another_folder(views, tmp_path):
    images(tmp_path, views)
    images(tmp_path, views, "depth/{:03d}.png")
    (tmp_path / "images/002.png").unlink()
    ball.save(
        tmp_path / "transforms.json", ball.transforms([c for c, _ in views], [f"images/{i:03d}.png" for i in range(VIEWS)])
    )
    capture = open_capture(tmp_path)
    assert "002" not in capture.cameras and "images/002.png" in capture.warnings[0]


def test_nothing_outside_the_capture_is_listed(views, tmp_path):
    images(tmp_path, views, "elsewhere/{:03d}.png")
    ball.write(tmp_path / "elsewhere/private.png", views[0][1])
    root = tmp_path / "capture"
    ball.save(
        root / "transforms.json", ball.transforms([c for c, _ in views], [f"../elsewhere/{i:03d}.png" for i in range(VIEWS)])
    )
    capture = open_capture(root)
    assert len(capture.views) == VIEWS
    assert not any("private" in text for text in (*capture.warnings, *map(str, capture.files)))


def blender(root, views, parts):
    for part, which in parts.items():
        for j, i in enumerate(which):
            ball.write(root / part / f"r_{j}.png", views[i][1])
        table = ball.transforms([views[i][0] for i in which], [f"./{part}/r_{j}" for j in range(len(which))])
        for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
            del table[key]
        table["camera_angle_x"] = 2 * np.arctan(ball.SIZE / 2 / ball.FOCAL)
        ball.save(root / f"transforms_{part}.json", table)


@pytest.mark.parametrize("folder", ["", "lego"])
def test_tables_of_train_validation_and_test_views(folder, views, tmp_path):
    parts = {"train": (0, 1, 2, 3), "val": (4,), "test": (5,)}
    blender(tmp_path / folder, views, parts)
    ball.write(tmp_path / folder / "test/r_0_normal_0001.png", views[0][1])
    capture = open_capture(tmp_path)
    names = {f"{part}_r_{j}": i for part, which in parts.items() for j, i in enumerate(which)}
    assert {n.split("_", 1)[1] if folder and not n.startswith(tuple(parts)) else n for n in capture.cameras} == set(names)
    for view, part in capture.parts.items():
        assert part == {"train": "train", "val": "validation", "test": "test"}[next(p for p in parts if f"{p}_r" in view)]
        truth = views[names[view]][0]
        np.testing.assert_allclose(capture.cameras[view].world_to_camera, truth.world_to_camera, atol=1e-9)


def test_train_views_alone_hold_nothing_out(views, tmp_path):
    blender(tmp_path, views, {"train": range(VIEWS)})
    assert open_capture(tmp_path).parts is None


def test_lists_of_nerfstudio_hold_test_views_out(views, tmp_path):
    images(tmp_path, views)
    table = ball.transforms([c for c, _ in views], [f"images/{i:03d}.png" for i in range(VIEWS)])
    ball.save(tmp_path / "transforms.json", {**table, "test_filenames": ["images/003.png"]})
    assert [v for v, part in open_capture(tmp_path).parts.items() if part == "test"] == ["003"]


@pytest.mark.parametrize("place", ["scene", "images"])
def test_a_table_one_folder_down(place, views, tmp_path):
    images(tmp_path / place, views, "images/{:03d}.png" if place == "scene" else "{:03d}.png")
    name = "images/{:03d}.png" if place == "scene" else "{:03d}.png"
    ball.save(
        tmp_path / place / "transforms.json", ball.transforms([c for c, _ in views], [name.format(i) for i in range(VIEWS)])
    )
    capture = open_capture(tmp_path)
    assert len(capture.cameras) == VIEWS and capture.layout == "rgb_transforms"


def test_several_captures_in_one_folder_are_named(views, tmp_path):
    for name in ("a", "b"):
        images(tmp_path / name, views)
        table = ball.transforms([c for c, _ in views], [f"images/{i:03d}.png" for i in range(VIEWS)])
        ball.save(tmp_path / name / "transforms.json", table)
    with pytest.raises(UserError, match=r"several captures \(a/, b/\)"):
        open_capture(tmp_path)


def test_cameras_one_folder_up_are_named_not_read(views, tmp_path):
    images(tmp_path, views)
    ball.save(
        tmp_path / "transforms.json", ball.transforms([c for c, _ in views], [f"images/{i:03d}.png" for i in range(VIEWS)])
    )
    capture = open_capture(tmp_path / "images")
    assert capture.cameras is None and f"CAPTURE={tmp_path}" in capture.warnings[0]


# ---- COLMAP ----------------------------------------------------------------------------------------------------------
def test_the_largest_of_several_models_is_used_and_said(views, tmp_path):
    images(tmp_path, views)
    colmap(tmp_path / "sparse/0", views[:2])
    colmap(tmp_path / "sparse/1", views)
    capture = open_capture(tmp_path)
    same(capture, views)
    assert capture.colmap == tmp_path / "sparse/1"
    assert "sparse/0 with 2" in capture.warnings[0] and "world of its own" in capture.warnings[0]


@pytest.mark.parametrize("place", ["sparse/1", "sparse", "colmap/sparse/3", "scene/sparse/0"])
def test_models_in_other_places_are_found(place, views, tmp_path):
    images(tmp_path, views)
    colmap(tmp_path / place, views)
    same(open_capture(tmp_path), views)


def distorted_bin(folder, views):
    """A SIMPLE_RADIAL model in binary."""
    folder.mkdir(parents=True)
    out = struct.pack("<Q", len(views))
    for i, (c, _) in enumerate(views):
        pose = (*quaternion(c.world_to_camera[:3, :3]), *c.world_to_camera[:3, 3])
        out += struct.pack("<I7dI", i + 1, *pose, 1) + b"%03d.png\0" % i + struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(out)
    lens = struct.pack("<4d", ball.FOCAL, ball.SIZE / 2, ball.SIZE / 2, -0.1)
    (folder / "cameras.bin").write_bytes(struct.pack("<QIiQQ", 1, 1, 2, ball.SIZE, ball.SIZE) + lens)


@pytest.mark.parametrize("workspace", ["dense/0", "dense"])
def test_undistorted_images_have_the_model_that_lies_with_them(workspace, views, tmp_path):
    images(tmp_path / workspace, views)
    distorted_bin(tmp_path / "sparse/0", views)
    colmap(tmp_path / workspace / "sparse", views)
    capture = open_capture(tmp_path)
    same(capture, views)
    assert not any(any(c.distortion) for c in capture.cameras.values()) and capture.colmap == tmp_path / workspace / "sparse"
    shutil.rmtree(tmp_path / workspace / "sparse")
    with pytest.raises(UserError, match="holds undistorted images"):
        open_capture(tmp_path)


def test_originals_keep_the_model_that_was_found_from_them(views, tmp_path):
    images(tmp_path, views)
    images(tmp_path / "dense/0", views)
    distorted_bin(tmp_path / "sparse/0", views)
    colmap(tmp_path / "dense/0/sparse", views)
    assert open_capture(tmp_path).cameras["000"].distortion[0] == -0.1


def test_an_entry_serves_one_view(views, tmp_path):
    """cam2/001 has no camera: it must not get cam1/001's."""
    for cam in ("cam1", "cam2"):
        images(tmp_path, views, f"images/{cam}/{{:03d}}.png")
    colmap(tmp_path / "sparse/0", views, "cam1/{:03d}.png")
    capture = open_capture(tmp_path)
    assert sorted(capture.cameras) == [f"cam1_{i:03d}" for i in range(VIEWS)]
