"""Lens models are COLMAP's and OpenCV's, both ways; where a model folds it says nothing."""

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.colmap import MODELS as COLMAP_MODELS
from pipeline.formats.colmap import coefficient_names, parameters_of
from pipeline.geometry.cameras import Camera, camera_from_frame
from pipeline.geometry.lens_inverse import fold, inside_fold, pixels_per_radian, unproject
from pipeline.geometry.lens_models import MODELS, project
from pipeline.geometry.straight_camera import unreached

COEFFICIENTS = {
    "OPENCV": (-0.2, 0.05, 0.003, -0.002),
    "FULL_OPENCV": (-0.2, 0.05, 0.003, -0.002, 0.01, 0.02, -0.01, 0.003),
    "FOV": (0.9,),
    "DIVISION": (-0.15,),
    "EUCM": (0.6, 1.1),
    "OPENCV_FISHEYE": (0.03, 0.005, 0.0006, 0.0001),
    "THIN_PRISM_FISHEYE": (0.03, 0.005, 0.002, -0.003, 0.0006, 0.0001, 0.001, -0.002),
    "RAD_TAN_THIN_PRISM_FISHEYE": (0.03, 0.005, 0.0006, 0.0001, 0.0002, -0.0001, 0.002, -0.003, 0.001, -0.002, 0.0015, 5e-4),
    "EQUIRECTANGULAR": (),
}
FOCAL, CENTRE = np.array([400.0, 410.0]), np.array([320.0, 240.0])
TO_PX = 1e-9


def rays(lowest):
    found = np.random.default_rng(0).normal(size=(4000, 3))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return np.concatenate([found[found[:, 2] > lowest], [[0, 0, 1.0], [1e-9, 0, 1], [1e-14, 1e-14, 2.0]]])


@pytest.mark.parametrize("model", sorted(set(MODELS)))
def test_every_model_is_colmaps_and_its_inverse_goes_back(model):
    import pycolmap

    coefficients = COEFFICIENTS[model]
    seen = rays(0.3 if model in ("OPENCV", "FULL_OPENCV") else 0.05)
    points = project(model, coefficients, seen)
    if model == "EQUIRECTANGULAR":
        seen, points = rays(-2.0), project(model, coefficients, rays(-2.0))
        camera = pycolmap.Camera(model=model, width=720, height=360, params=[720, 360])
        pixels = points * 360 / np.pi + [360, 180]
    else:
        camera = pycolmap.Camera(model=model, width=640, height=480, params=[*FOCAL, *CENTRE, *coefficients])
        pixels = points * FOCAL + CENTRE
    np.testing.assert_allclose(pixels, camera.img_from_cam(seen, check_cheirality=False), atol=TO_PX)
    back = unproject(model, coefficients, points)
    np.testing.assert_allclose(back, seen / np.linalg.norm(seen, axis=1, keepdims=True), atol=1e-9)


def test_fisheye_and_rational_models_are_opencvs():
    import cv2

    matrix = np.array([[FOCAL[0], 0, CENTRE[0]], [0, FOCAL[1], CENTRE[1]], [0, 0, 1.0]])
    seen, none = rays(0.3), np.zeros(3)
    k = COEFFICIENTS["OPENCV_FISHEYE"]
    theirs = cv2.fisheye.projectPoints((seen / seen[:, 2:])[:, None], none, none, matrix, np.array(k))[0][:, 0]
    np.testing.assert_allclose(project("OPENCV_FISHEYE", k, seen) * FOCAL + CENTRE, theirs, atol=1e-6)
    k = COEFFICIENTS["FULL_OPENCV"]
    theirs = cv2.projectPoints(seen, none, none, matrix, np.array(k))[0][:, 0]
    np.testing.assert_allclose(project("FULL_OPENCV", k, seen) * FOCAL + CENTRE, theirs, atol=1e-6)


def test_a_fisheye_sees_behind_itself():
    beside = np.array([[1.0, 0, -0.5], [0, -1.0, -0.2]])
    points = project("OPENCV_FISHEYE", (0.0,) * 4, beside)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), np.arctan2(1, [-0.5, -0.2]))
    unit = beside / np.linalg.norm(beside, axis=1, keepdims=True)
    np.testing.assert_allclose(unproject("OPENCV_FISHEYE", (0.0,) * 4, points), unit, atol=1e-12)
    assert np.isnan(project("OPENCV", (), beside)).all()


def test_past_the_fold_there_is_nothing():
    k = (-0.3, 0.0, 0.0, 0.0)
    radius = 1 / np.sqrt(3 * 0.3)  # where the derivative of r - 0.3 r³ is 0
    assert fold("OPENCV", k).angles == pytest.approx(np.arctan(radius), abs=2e-3)
    assert inside_fold("OPENCV", k, np.array([[0.9 * radius, 0, 1], [0, 1.1 * radius, 1.0]])).tolist() == [True, False]
    assert np.isnan(unproject("OPENCV", k, np.array([[0.75, 0.0]]))).all()  # further out than any ray comes
    wide, narrow = (Camera(100, 80, f, f, 50, 40, np.eye(4), k) for f in (60.0, 200.0))
    assert unreached(wide) > 0.5 and unreached(narrow) == 0


def test_the_local_scale_is_the_derivative():
    assert pixels_per_radian("OPENCV", (), (300.0, 300.0), np.array([0, 0, 1.0])) == pytest.approx(300)
    side = np.array([np.sin(1.0), 0, np.cos(1.0)])  # an equidistant fisheye squeezes circles about its axis by θ / sin θ
    assert pixels_per_radian("OPENCV_FISHEYE", (0.0,) * 4, (300.0, 300.0), side) == pytest.approx(300 * np.sqrt(1 / np.sin(1)))


def frame(**more):
    return {"file_path": "images/0.png", "transform_matrix": np.eye(4).tolist(), "fl_x": 50, "w": 60, "h": 40, **more}


@pytest.mark.parametrize(
    ("keys", "lens", "distortion"),
    [
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k4": 0.2}, "OPENCV_FISHEYE", (0.1, 0, 0, 0.2)),
        ({"is_fisheye": True, "k2": 0.1}, "OPENCV_FISHEYE", (0, 0.1, 0, 0)),
        ({"camera_model": "OPENCV", "k3": 0.1, "p2": 0.2}, "FULL_OPENCV", (0, 0, 0, 0.2, 0.1, 0, 0, 0)),
        ({"k4": 0.1, "k5": 0.2, "k6": 0.3}, "FULL_OPENCV", (0, 0, 0, 0, 0, 0.1, 0.2, 0.3)),
        ({"camera_model": "full_opencv", "k4": 0.1}, "FULL_OPENCV", (0, 0, 0, 0, 0, 0.1, 0, 0)),
        ({"camera_model": "SIMPLE_RADIAL", "k1": 0.1}, "OPENCV", (0.1, 0, 0, 0)),
        ({"camera_model": "SIMPLE_RADIAL_FISHEYE", "k1": 0.1}, "OPENCV_FISHEYE", (0.1, 0, 0, 0)),
        ({"camera_model": "PINHOLE", "k1": 0.0, "k6": 0}, "OPENCV", ()),
        ({"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR", ()),
        ({"distortion_params": [0.1, 0, 0, 0, 0.2, 0]}, "OPENCV", (0.1, 0, 0.2, 0)),
    ],
)
def test_a_frames_lens_is_read_whole(tmp_path, keys, lens, distortion):
    camera = camera_from_frame(frame(**keys), {}, tmp_path / "transforms.json")
    assert (camera.lens, camera.distortion) == (lens, distortion)
    told = frame(**keys)
    rest = {"file_path": told.pop("file_path"), "transform_matrix": told.pop("transform_matrix")}
    from_head = camera_from_frame(rest, told, tmp_path / "transforms.json")
    assert (from_head.lens, from_head.distortion, from_head.fx) == (lens, distortion, camera.fx)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"camera_model": "OPENCV", "k4": 0.1}, ("k4", "OPENCV")),
        ({"camera_model": "OPENCV_FISHEYE", "p1": 0.1}, ("p1", "OPENCV_FISHEYE")),
        ({"camera_model": "PINHOLE", "k1": 0.1}, ("k1", "PINHOLE", "undistorted")),
        ({"camera_model": "RADIAL", "k3": 0.1}, ("k3", "RADIAL")),
        ({"camera_model": "VR180_L"}, ("VR180_L", "undistort")),
        ({"ftheta_p1": 0.3}, ("ftheta_p1",)),
        ({"k1": "much"}, ("k1", "number")),
        ({"k1": float("nan")}, ("k1", "number")),
        ({"distortion_params": 4}, ("distortion_params",)),
    ],
)
def test_what_a_lens_model_has_no_place_for_is_refused_by_name(tmp_path, keys, words):
    with pytest.raises(UserError) as caught:
        camera_from_frame(frame(**keys), {}, tmp_path / "transforms.json")
    line = str(caught.value)
    assert "\n" not in line and "images/0.png" in line and "transforms.json" in line
    for word in words:
        assert word in line


def test_every_colmap_model_has_its_coefficients_by_name():
    for name, count in COLMAP_MODELS.values():
        if name != "EQUIRECTANGULAR":
            single = name.startswith(("SIMPLE", "RADIAL"))
            assert len(coefficient_names(name)) == count - (3 if single else 4) or name == "FISHEYE"
    fisheye = Camera(60, 40, 50.0, 51.0, 30.0, 20.0, np.eye(4), (0.1, 0.2, 0.3, 0.4), lens="OPENCV_FISHEYE")
    assert parameters_of(fisheye) == ("OPENCV_FISHEYE", [50.0, 51.0, 30.0, 20.0, 0.1, 0.2, 0.3, 0.4])
