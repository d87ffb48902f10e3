"""LLFF's poses_bounds.npy: a row per sorted image, [down, right, back | centre | height width focal] and two depths."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.capture.camera_files.table import CameraTable, Size
from pipeline.errors import UserError
from pipeline.formats.arrays import read_array
from pipeline.geometry.cameras import Camera, camera_from_opengl

FILE = "poses_bounds.npy"


def find(folders: list[Path]) -> Path | None:
    """A poses_bounds.npy in one of the folders."""
    return next((folder / FILE for folder in folders if (folder / FILE).is_file()), None)


def read(path: Path) -> CameraTable:
    """Its cameras, for images of its size or scaled. Raises UserError."""
    rows = np.asarray(read_array(path), np.float64)
    if rows.ndim != 2 or rows.shape[1] not in (15, 17) or not len(rows) or not np.isfinite(rows).all():
        raise UserError(path, f"is no table of 17 finite numbers an image (it is {rows.shape})", "export it again")
    blocks = rows[:, :15].reshape(-1, 3, 5)

    def camera(index: int, size: Size) -> Camera:
        down, right, back, centre, hwf = blocks[index].T
        matrix = np.stack([right, -down, back, centre], axis=1)
        if np.linalg.matrix_rank(matrix[:, :3]) < 3 or not hwf.min() > 0:
            raise UserError(path, f"row {index} holds no rotation, or no size and focal length", "export it again")
        height, width, focal = hwf
        return Camera(round(width), round(height), focal, focal, width / 2, height / 2, camera_from_opengl(matrix))

    return CameraTable(path, "LLFF", None, len(rows), camera, (path,))
