"""Cameras for a set of views from whatever lies beside them: a COLMAP model, or another program's camera file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.camera_files import bundler, llff, metashape, middlebury
from pipeline.capture.camera_files.table import CameraTable, Size, cameras_of_views, entries_in_order
from pipeline.capture.camera_files.unread import unread
from pipeline.capture.model import ViewSource
from pipeline.capture.naming.files import IMAGE_FOLDERS, UNDISTORTED, count, subfolders
from pipeline.errors import UserError
from pipeline.formats.arrays import array_names, read_arrays
from pipeline.formats.colmap import find_models, forms_differ, model_files, read_model, registered_images
from pipeline.geometry.camera_check import check_camera
from pipeline.geometry.cameras import Camera

IDR = ("cameras_sphere.npz", "cameras.npz", "cameras_large.npz", "cameras_*.npz")
"""NeuS' and IDR's names; those of one capture differ in scale_mat alone, which is not used."""
SINGULAR = 1e-12
"""Inverse condition number; that of K R is about one over the focal length in pixels."""


def camera_table(root: Path, folder: Path) -> tuple[CameraTable | None, list[str]]:
    """The cameras that lie beside the images in `folder` of the capture `root`, and what to tell of others.

    Looked for beside the images, above them up to the capture, and one folder below it. Raises UserError.
    """
    near = _around(root, folder)
    found = [t for t in (_colmap(near, root, folder), *_other_tables(near)) if t is not None]
    if not found:
        return None, unread(near) + _one_folder_up(root)
    first, others = found[0], found[1:]
    facts = tuple(f"cameras of {first.path.name} are used; {t.path} is not" for t in others)
    return replace(first, facts=(*first.facts, *facts)), []


def _around(root: Path, folder: Path) -> list[Path]:
    """Folders in which a camera file may lie: from the images' up to the capture's, then those one below it."""
    above = [p for p in (folder, *folder.parents) if p == root or p.is_relative_to(root)]
    return list(dict.fromkeys([*above, *subfolders(root)]))


def _one_folder_up(root: Path) -> list[str]:
    """Cameras beside a folder of images that was given alone are named, not read: they lie outside the capture."""
    names = ("transforms.json", "transforms_train.json", "sparse", "cameras_sphere.npz", "poses_bounds.npy")
    found = next((root.parent / n for n in names if root.name in IMAGE_FOLDERS and (root.parent / n).exists()), None)
    if found is None:
        return []
    return [f"{found}: lies outside the capture and is not read; give CAPTURE={root.parent} to use its cameras"]


def _colmap(near: list[Path], root: Path, folder: Path) -> CameraTable | None:
    """The largest of the COLMAP models nearest to the images."""
    models = next((found for place in _model_places(near, root, folder) if (found := find_models(place))), [])
    if not models:
        return None
    place = models[0]
    model = read_model(place)
    if any(p.name in UNDISTORTED for p in folder.parents if p != root and p.is_relative_to(root)):
        _refuse_undistorted_twice(place, folder, model.cameras)
    names = tuple(model.cameras)
    warnings = []
    rest = [m for m in models[1:] if m.parent == place.parent]
    if rest:
        sizes = ", ".join(f"{m.relative_to(root).as_posix()} with {registered_images(m)}" for m in rest)
        warnings.append(
            f"{place}: this model of {count(names, 'image')} is used and {sizes} left out: "
            "each has a world of its own; check that it is the right one, or find all cameras in one model"
        )
    if forms_differ(place, model):
        fault = "holds the model twice, as binary and as text, and they differ: the binary one is used"
        warnings.append(f"{place}: {fault}; remove the one that is out of date")
    cameras = list(model.cameras.values())
    return CameraTable(
        place, "COLMAP", names, len(names), lambda i, _: cameras[i], model_files(place), model=place, warnings=tuple(warnings)
    )


def _model_places(near: list[Path], root: Path, folder: Path) -> list[Path]:
    """Where a model of these images may lie: with images below dense/ first the one that was written with them."""
    beside = [p for p in (folder, *folder.parents) if p != root and p.is_relative_to(root)]
    below = [p for p in near if p not in beside and p != root]
    return [*beside, root, *below]


def _refuse_undistorted_twice(place: Path, folder: Path, cameras: Mapping[str, Camera]) -> None:
    if not place.is_relative_to(folder.parent) and not all(c.is_pinhole for c in cameras.values()):
        fault = f"holds undistorted images, but the model {place} has lens distortion and was not written with them"
        raise UserError(folder, fault, f"add the model that was ({folder.parent / 'sparse'}), or give the original images")


def _other_tables(near: list[Path]) -> list[CameraTable]:
    """Tables of other programs, one of each kind."""
    found: list[CameraTable] = []
    npz = next((p for folder in near for pattern in IDR for p in sorted(folder.glob(pattern)) if is_idr(p)), None)
    if npz is not None:
        found.append(idr_table(npz))
    for reader in (metashape, middlebury, bundler, llff):
        path = reader.find(near)
        if path is not None:
            found.append(reader.read(path))
    return found


def from_colmap(
    root: Path, views: tuple[ViewSource, ...], folder: Path
) -> tuple[dict[str, Camera], Path | None, list[str], tuple[Path, ...]]:
    """Cameras by VIEW of a COLMAP model beside the images: (cameras, model folder, warnings, files read).

    Empty without a model. Names match by the longest common end of the path.
    """
    table = _colmap([folder, root], root, folder)
    if table is None:
        return {}, None, [], ()
    cameras, warnings = cameras_of_views(table, views, folder)
    return cameras, table.model, warnings, table.files


def is_idr(path: Path) -> bool:
    """Whether an archive holds world_mat_i (a name check; a damaged one is left to its reader)."""
    try:
        return any(name.startswith("world_mat_") for name in array_names(path))
    except UserError:
        return path.name in IDR


def idr_table(path: Path) -> CameraTable:
    """cameras.npz of IDR, NeuS and PANDORA: `world_mat_i` = K [R t], projecting to pixels; i counts the sorted views.

    World units are those of world_mat; scale_mat, which maps a unit sphere to the object, is left to those who need it.
    Pixel centres are taken at +0.5. Raises UserError.
    """
    table = read_arrays(path, lambda name: name.startswith("world_mat_"))
    numbers = tuple(sorted(int(end) for k in table if (end := k.rsplit("_", 1)[1]).isdigit()))
    if not numbers:
        raise UserError(path, "has no world_mat_0, world_mat_1, ...", "write the file as IDR, NeuS and PANDORA do")

    def camera(index: int, size: Size) -> Camera:
        what = f"world_mat_{numbers[index]}"
        matrix = table[what]
        if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
            raise UserError(path, f"{what} is not a finite 4x4 matrix", "export the cameras again")
        with np.errstate(all="ignore"):
            singular = not 1 / np.linalg.cond(matrix[:3, :3]) > SINGULAR
        if singular:
            raise UserError(path, f"{what} is no camera: its left 3x3 part is singular", "export the cameras again")
        k, pose = decompose(matrix[:3])
        return check_camera(Camera(*size, k[0, 0], k[1, 1], k[0, 2], k[1, 2], pose), path, what)

    return CameraTable(path, path.name, None, len(numbers), camera, (path,), numbers)


def from_idr(path: Path, views: list[str], sizes: Mapping[str, tuple[int, int]]) -> dict[str, Camera]:
    """Cameras of a cameras.npz (see `idr_table`) by VIEW: in sorted order, or by number where counts differ."""
    table = idr_table(path)
    return {view: table.camera(i, sizes[view]) for view, i in entries_in_order(table, views).items()}


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
