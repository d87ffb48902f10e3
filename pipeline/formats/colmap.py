"""Reading a COLMAP model, text or binary, without pycolmap (which takes a second to import)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.geometry.camera_check import check_camera
from pipeline.geometry.cameras import Camera, camera_from_frame, opengl_from_camera
from pipeline.geometry.lens_keys import coefficient_names

# COLMAP's models by id: name and number of parameters (colmap/src/colmap/sensor/models.h).
MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4), 13: ("DIVISION", 5), 14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4), 16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}  # fmt: skip
PARAMETERS = dict(MODELS.values())
ONE_FOCAL = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_DIVISION",
             "SIMPLE_FISHEYE"}  # fmt: skip
POINT_BYTES = 51  # of points3D.bin, without a track
FILES = ("cameras", "images", "points3D")
PLACES = (
    ("sparse/*", "sparse"),
    ("colmap/sparse/*", "colmap/sparse", "colmap"),
    ("distorted/sparse/*", "distorted/sparse"),
    ("",),
)
"""Where models lie below a capture, the nearer to the images first; within a group the largest is the capture's."""


@dataclass(frozen=True)
class ColmapModel:
    """A COLMAP model's cameras and points, in the model's own world.

    Fields:
        cameras: image name, as the model has it, to its camera.
        points: world positions. [N, 3]
        colours: of the points, 8 bits sRGB. [N, 3]
    """

    cameras: dict[str, Camera]
    points: NDArray[np.float64]
    colours: NDArray[np.uint8]


def find_models(root: Path) -> list[Path]:
    """Find the COLMAP models of a capture in the first of the usual `PLACES` that has any.

    Args:
        root: the capture's folder.

    Returns:
        The models' folders, most registered images first; empty where there is none.
    """
    for group in PLACES:
        found = [f for place in group for f in (sorted(root.glob(place)) if place else [root]) if holds_model(f)]
        if found:
            return sorted(found, key=registered_images, reverse=True)
    return []


def find_model(root: Path) -> Path | None:
    """Find the COLMAP model of a capture; of several, that with the most images.

    Args:
        root: the capture's folder.

    Returns:
        The model's folder, None where there is none.
    """
    return next(iter(find_models(root)), None)


def holds_model(folder: Path) -> bool:
    """Say whether a folder holds a COLMAP model's cameras and images, binary or text.

    Args:
        folder: any.
    """
    return any(all((folder / f"{name}{suffix}").is_file() for name in FILES[:2]) for suffix in (".bin", ".txt"))


def registered_images(folder: Path) -> int:
    """Count the images that a model has cameras for.

    Args:
        folder: the model's.

    Returns:
        The number, from the binary file's head or the text's lines; 0 where the file is missing or cannot be read.
    """
    path = next((p for p in model_files(folder) if p.stem == "images"), None)
    if path is None:
        return 0
    try:
        if path.suffix == ".bin":
            with path.open("rb") as stream:
                return int(struct.unpack("<Q", stream.read(8))[0])
        return len(_images_txt(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, IndexError, struct.error):
        return 0


def model_files(folder: Path, text: bool = False) -> tuple[Path, ...]:
    """Name the files of a model that are read.

    Args:
        folder: the model's.
        text: those of its text form, whatever else there is.

    Returns:
        Those of cameras, images and points3D that exist: binary if both of the first are there so, else text.
    """
    suffix = ".txt" if text or not all((folder / f"{name}.bin").is_file() for name in FILES[:2]) else ".bin"
    return tuple(p for p in (folder / f"{name}{suffix}" for name in FILES) if p.is_file())


def read_model(folder: Path, text: bool = False) -> ColmapModel:
    """Read a COLMAP model, text or binary.

    Args:
        folder: the model's.
        text: its text form, whatever else there is.

    Returns:
        Its cameras (world-to-camera, OpenCV axes) and points; no points where it has no points3D file.

    Raises:
        UserError: a file is malformed or holds what can be no camera, or no image is registered.
    """
    files = {p.stem: p for p in model_files(folder, text)}
    binary = files["cameras"].suffix == ".bin"
    at = files["cameras"]
    try:
        lenses = _cameras_bin(at.read_bytes()) if binary else _cameras_txt(at.read_text())
        at = files["images"]
        images = _images_bin(at.read_bytes()) if binary else _images_txt(at.read_text(encoding="utf-8"))
        points, colours = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
        if "points3D" in files:
            at = files["points3D"]
            points, colours = _points_bin(at.read_bytes()) if binary else _points_txt(at.read_text())
        at = files["images"]
        cameras = {name: _camera(lenses[camera_id], matrix, files, name) for name, camera_id, matrix in images}
    except (struct.error, ValueError, IndexError, KeyError, OverflowError, UnicodeDecodeError) as error:
        raise UserError(at, f"is not a COLMAP model ({type(error).__name__}: {error})", "export the model again") from None
    if not cameras:
        raise UserError(files["images"], "the COLMAP model has no registered image", "delete it to find the cameras anew")
    return ColmapModel(cameras, points, colours)


SAME_FORM = 1e-4
"""Relative: text is written with six digits and more."""


def forms_differ(folder: Path, model: ColmapModel) -> bool:
    """Say whether a folder holds a model as text besides as binary, and the text has other cameras.

    Args:
        folder: the model's.
        model: as it was read.
    """
    text = model_files(folder, text=True)
    if model_files(folder) == text or {p.stem for p in text} < set(FILES[:2]):
        return False
    try:
        other = read_model(folder, text=True).cameras
    except UserError:
        return True
    return set(other) != set(model.cameras) or not all(_alike(other[name], c) for name, c in model.cameras.items())


def _alike(first: Camera, second: Camera) -> bool:
    one, other = (np.array([c.width, c.height, c.fx, c.fy, c.cx, c.cy, *c.distortion]) for c in (first, second))
    scale = max(1.0, float(np.abs(second.world_to_camera).max()))
    posed = np.allclose(first.world_to_camera, second.world_to_camera, rtol=0, atol=SAME_FORM * scale)
    return posed and len(one) == len(other) and np.allclose(one, other, rtol=SAME_FORM, atol=SAME_FORM)


Lens = tuple[str, int, int, list[float]]


def _camera(lens: Lens, matrix: NDArray[np.float64], files: Mapping[str, Path], image: str) -> Camera:
    """One image's camera, checked: a fault of the pose is images', one of the lens is cameras'."""
    model, width, height, numbers = lens
    pose = Camera(1, 1, 1.0, 1.0, 0.5, 0.5, matrix)
    check_camera(pose, files["images"], f"image {image}")
    if PARAMETERS.get(model) != len(numbers):
        fault = f"{len(numbers)} parameters for {model}" if model in PARAMETERS else f"the lens model {model} is not supported"
        raise UserError(files["cameras"], fault, "undistort with `colmap image_undistorter` first")
    if model == "EQUIRECTANGULAR":
        frame: dict[str, float] = {"w": width, "h": height}
    else:
        focal = 1 if model in ONE_FOCAL else 2
        frame = dict(zip(("fl_x", "fl_y")[:focal], numbers)) | dict(zip(("cx", "cy"), numbers[focal:]))
        frame |= dict(zip(coefficient_names(model), numbers[focal + 2 :])) | {"w": width, "h": height}
    entry = {"camera_model": model, "file_path": image, "transform_matrix": opengl_from_camera(matrix), **frame}
    camera = camera_from_frame(entry, {}, files["cameras"])
    return replace(camera, world_to_camera=matrix)


def parameters_of(camera: Camera) -> tuple[str, list[float]]:
    """Write a camera's lens as COLMAP does.

    Args:
        camera: pinhole or with a lens; lengths in pixels.

    Returns:
        COLMAP's name of the lens model, and its parameters in COLMAP's order (fx, fy, cx, cy in pixels, then the distortion).
    """
    if camera.lens == "EQUIRECTANGULAR":
        return camera.lens, [float(camera.width), float(camera.height)]
    pinhole = [camera.fx, camera.fy, camera.cx, camera.cy]
    return ("PINHOLE", pinhole) if camera.is_pinhole else (camera.lens, [*pinhole, *camera.distortion])


def pose_matrix(q: Iterable[float], t: Iterable[float]) -> NDArray[np.float64]:
    """World-to-camera [4, 4] of COLMAP's quaternion (w, x, y, z) and translation."""
    quaternion = np.array(list(q), float)
    with np.errstate(invalid="ignore", divide="ignore"):  # a zero one is no rotation: NaN, which no camera has
        w, x, y, z = quaternion / np.linalg.norm(quaternion)
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = list(t)
    return out


def _lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if not line.startswith("#")]


def _cameras_txt(text: str) -> dict[int, tuple[str, int, int, list[float]]]:
    rows = [line.split() for line in _lines(text) if line.strip()]
    return {int(r[0]): (r[1], int(r[2]), int(r[3]), [float(x) for x in r[4:]]) for r in rows}


def _images_txt(text: str) -> list[tuple[str, int, NDArray[np.float64]]]:
    """Two lines an image, the second its 2D points (triples of numbers, or blank); some programs leave it out."""
    out, points_next = [], False
    for line in _lines(text):
        if points_next and _holds_points(line):
            points_next = False
        elif line.strip():
            r = line.split(maxsplit=9)
            out.append((r[9].strip(), int(r[8]), pose_matrix(map(float, r[1:5]), map(float, r[5:8]))))
            points_next = True
    return out


def _holds_points(line: str) -> bool:
    """Whether a line is an image's 2D points; an image's own line has ten entries, or more where its name has spaces."""
    entries = line.split()
    if len(entries) % 3:
        return False
    try:
        return all(float(x) is not None for x in (*entries[:12], *entries[-3:]))
    except ValueError:
        return False


def _points_txt(text: str) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    rows = [line.split()[:7] for line in _lines(text) if line.strip()]
    if not rows:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    table = np.array([[float(x) for x in r[1:7]] for r in rows])
    if table.shape[1:] != (6,):
        raise ValueError("a point has no position and colour")
    return _finite(table[:, :3], table[:, 3:6].astype(np.uint8))


def _finite(points: NDArray[np.float64], colours: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    there = np.isfinite(points).all(1)
    return points[there], colours[there]


def _cameras_bin(data: bytes) -> dict[int, tuple[str, int, int, list[float]]]:
    (n,), at, out = struct.unpack_from("<Q", data), 8, {}
    for _ in range(n):
        camera_id, model, width, height = struct.unpack_from("<IiQQ", data, at)
        name, k = MODELS[model]
        out[camera_id] = (name, width, height, list(struct.unpack_from(f"<{k}d", data, at + 24)))
        at += 24 + 8 * k
    return out


def _images_bin(data: bytes) -> list[tuple[str, int, NDArray[np.float64]]]:
    (n,), at, out = struct.unpack_from("<Q", data), 8, []
    for _ in range(n):
        numbers = struct.unpack_from("<I7dI", data, at)
        at += 64
        end = data.index(b"\0", at)
        name = data[at:end].decode("utf-8")
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points
        if at > len(data):
            raise ValueError("the file ends early")
        out.append((name, numbers[8], pose_matrix(numbers[1:5], numbers[5:8])))
    return out


def _points_bin(data: bytes) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    (n,), at = struct.unpack_from("<Q", data), 8
    if n > (len(data) - at) // POINT_BYTES:
        raise ValueError("the file ends early")
    points, colours = np.zeros((n, 3)), np.zeros((n, 3), np.uint8)
    for i in range(n):
        numbers = struct.unpack_from("<Q3d3BdQ", data, at)
        points[i], colours[i] = numbers[1:4], numbers[4:7]
        at += POINT_BYTES + 8 * numbers[8]
    return _finite(points, colours)
