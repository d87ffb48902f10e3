"""Bundler's bundle.out (v0.3): f k1 k2, R, t per camera; the images' names in list.txt, else in sorted order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.capture.camera_files.table import CameraTable, Size
from pipeline.errors import UserError
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, Camera

LISTS = ("list.txt", "bundle/list.txt", "list_focal.txt", "pictures.txt")


def find(folders: list[Path]) -> Path | None:
    """A bundle.out in one of the folders, or in bundle/ there."""
    places = (folder / name for folder in folders for name in ("bundle.out", "bundle/bundle.out", "bundle.rd.out"))
    return next((p for p in places if p.is_file()), None)


def read(path: Path) -> CameraTable:
    """Its cameras: they look along -z with y up, the image's origin is its middle, f is in pixels. Raises UserError."""
    listed = next((p for f in (path.parent, path.parent.parent) for n in LISTS if (p := f / n).is_file()), None)
    names = None
    if listed is not None:
        names = [line.split()[0] for line in listed.read_text(errors="replace").splitlines() if line.strip()]
    try:
        words = " ".join(x for x in path.read_text(errors="replace").splitlines() if not x.startswith("#")).split()
        n = int(words[0])
        numbers = np.array([float(x) for x in words[2 : 2 + 15 * n]])
        if numbers.shape != (15 * n,) or not np.isfinite(numbers).all() or n < 1:
            raise ValueError("it ends early")
    except (ValueError, IndexError) as error:
        raise UserError(path, f"is no Bundler file ({error})", "copy it again from its source") from None
    if names is not None and len(names) != n:
        fault = f"lists {len(names)} images, {path.name} holds {n} cameras"
        raise UserError(listed or path, fault, "use the list that the cameras were found with")
    rows = numbers.reshape(n, 15)
    placed = [i for i in range(n) if rows[i, 0] > 0]
    if not placed:
        raise UserError(path, "holds no camera that was found (every focal length is 0)", "find the cameras again")
    if names is None and len(placed) < n:
        fault = f"has {n - len(placed)} cameras that were not found, and no list.txt names the images"
        raise UserError(path, fault, "add list.txt")

    def camera(index: int, size: Size) -> Camera:
        row = rows[placed[index]]
        turn = row[3:12].reshape(3, 3)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, row[12:]
        lens = (float(row[1]), float(row[2]), 0.0, 0.0) if row[1:3].any() else ()
        return Camera(*size, row[0], row[0], size[0] / 2, size[1] / 2, OPENGL_FROM_OPENCV @ pose, lens)

    files = (path,) if listed is None else (path, listed)
    kept = tuple(names[i] for i in placed) if names is not None else None
    return CameraTable(path, "Bundler", kept, len(placed), camera, files)
