"""Cameras for a set of views from whatever lies beside them: a COLMAP model, or IDR-style cameras.npz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.model import ViewSource
from pipeline.capture.naming.files import count, some
from pipeline.errors import UserError
from pipeline.formats.arrays import read_arrays
from pipeline.formats.colmap import find_model, model_files, read_model
from pipeline.geometry.camera_check import check_camera
from pipeline.geometry.cameras import Camera

SINGULAR = 1e-12
"""Inverse condition number; that of K R is about one over the focal length in pixels."""


def from_colmap(
    root: Path, views: tuple[ViewSource, ...], folder: Path
) -> tuple[dict[str, Camera], Path | None, list[str], tuple[Path, ...]]:
    """Cameras by VIEW of a COLMAP model beside the images: (cameras, model folder, warnings, files read).

    Empty without a model. Names match by path, by VIEW, or by the file's own name where that is unique.
    """
    place = find_model(root)
    if place is None:
        return {}, None, [], ()
    model = read_model(place)
    by_name: dict[str, Camera] = {}
    bare: dict[str, list[Camera]] = {}
    for name, camera in model.cameras.items():
        stem = PurePosixPath(name).with_suffix("").as_posix() if PurePosixPath(name).suffix else name
        by_name[stem] = camera
        bare.setdefault(PurePosixPath(stem).name, []).append(camera)
    cameras: dict[str, Camera] = {}
    missing: list[str] = []
    for view in views:
        found: Camera | None = None
        for path in view.paths:
            stem = path.relative_to(folder).with_suffix("").as_posix()
            alone = bare.get(path.stem, [])
            found = found or by_name.get(stem) or (alone[0] if len(alone) == 1 else None)
        found = found or by_name.get(view.view)
        if found is None:
            missing.append(view.view)
            continue
        if view.size is not None and (found.width, found.height) != view.size:
            if not _same_shape(found, view.size):
                have, want = f"{view.size[0]}x{view.size[1]}", f"{found.width}x{found.height}"
                raise UserError(
                    view.paths[0], f"is {have}, its COLMAP camera {want}", "use the images that COLMAP saw, unrotated"
                )
            found = found.resized(*view.size)
        cameras[view.view] = replace(found, name=view.camera)
    if not cameras:
        raise UserError(
            place, f"none of its images is here (first: {next(iter(model.cameras))})", "give the images COLMAP's names"
        )
    warnings = []
    if missing:
        warnings.append(f"{place}: no camera for {count(missing, 'view')} ({some(missing)}); left out")
    spare = len(model.cameras) - len(cameras)
    if spare > 0:
        warnings.append(f"{place}: no image for {spare} of its cameras; left out")
    return cameras, place, warnings, model_files(place)


def _same_shape(camera: Camera, size: tuple[int, int]) -> bool:
    """Whether `size` is the camera's frame scaled, to a pixel."""
    return abs(camera.width * size[1] - camera.height * size[0]) <= max(camera.width, camera.height)


def from_idr(path: Path, views: list[str], sizes: Mapping[str, tuple[int, int]]) -> dict[str, Camera]:
    """Cameras of cameras.npz (`world_mat_i` = K [R t], projecting to pixels; i counts the sorted views).

    World units are those of world_mat; scale_mat, which maps a unit sphere to the object, is left to those who need it.
    Pixel centres are taken at +0.5. Raises UserError.
    """
    table = read_arrays(path, lambda name: name.startswith("world_mat_"))
    numbers = sorted(int(k.rsplit("_", 1)[1]) for k in table if k.startswith("world_mat_") and k.rsplit("_", 1)[1].isdigit())
    if not numbers:
        raise UserError(path, "has no world_mat_0, world_mat_1, ...", "write the file as IDR, NeuS and PANDORA do")
    index = _index_of(views, numbers, path)
    cameras = {}
    for view, i in index.items():
        matrix = table[f"world_mat_{i}"]
        if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
            raise UserError(path, f"world_mat_{i} is not a finite 4x4 matrix", "export the cameras again")
        with np.errstate(all="ignore"):
            singular = not 1 / np.linalg.cond(matrix[:3, :3]) > SINGULAR
        if singular:
            raise UserError(path, f"world_mat_{i} is no camera: its left 3x3 part is singular", "export the cameras again")
        k, pose = decompose(matrix[:3])
        w, h = sizes[view]
        camera = Camera(w, h, k[0, 0], k[1, 1], k[0, 2], k[1, 2], pose)
        cameras[view] = check_camera(camera, path, f"world_mat_{i}")
    return cameras


def _index_of(views: list[str], numbers: list[int], path: Path) -> dict[str, int]:
    """Which world_mat belongs to which view: in sorted order, or by number where counts differ."""
    if len(views) == len(numbers):
        return dict(zip(sorted(views), numbers))
    digits = {view: "".join(c for c in view if c.isdigit()) for view in views}
    if all(d and int(d) in numbers for d in digits.values()) and len({int(d) for d in digits.values()}) == len(views):
        return {view: int(d) for view, d in digits.items()}
    raise UserError(path, f"holds {count(numbers, 'camera')} for {count(views, 'view')}", "give each view its world_mat")


def decompose(projection: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Intrinsics [3, 3] (positive focal lengths, last entry 1) and world-to-camera [4, 4] of a projection [3, 4].

    RQ by QR of the reversed matrix (Hartley and Zisserman 6.2.4); the sign of the whole matrix is free.
    """
    m = projection[:, :3]
    if np.linalg.det(m) < 0:
        projection, m = -projection, -m
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ m).T)
    k, rotation = flip @ r.T @ flip, flip @ q.T
    signs = np.diag(np.where(np.diag(k) < 0, -1.0, 1.0))
    k, rotation = k @ signs, signs @ rotation
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, np.linalg.solve(k, projection[:, 3])
    return k / k[2, 2], pose
