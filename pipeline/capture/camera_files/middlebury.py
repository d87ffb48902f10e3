"""Middlebury multi-view stereo: NAME_par.txt, a count and then per image its name, K, R (world to camera) and t."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.capture.camera_files.table import CameraTable, Size
from pipeline.errors import UserError
from pipeline.geometry.cameras import Camera


def find(folders: list[Path]) -> Path | None:
    """A *_par.txt in one of the folders."""
    return next((p for folder in folders for p in sorted(folder.glob("*_par.txt")) if not p.name.startswith(".")), None)


def read(path: Path) -> CameraTable:
    """Its cameras; pixel centres are taken at +0.5. Raises UserError."""
    rows = [line.split() for line in path.read_text(errors="replace").splitlines() if line.strip()]
    names, matrices = [], []
    try:
        for row in rows[1:]:
            numbers = np.array([float(x) for x in row[1:]])
            if numbers.shape != (21,) or not np.isfinite(numbers).all():
                raise ValueError(f"{row[0]} has {len(numbers)} numbers, not 21")
            k, rotation = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3)
            if abs(k[0, 1]) > 1e-3 * abs(k[0, 0]):
                raise ValueError(f"the intrinsics of {row[0]} have skew")
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, numbers[18:]
            names.append(row[0])
            matrices.append((k, pose))
        if not rows or int(rows[0][0]) != len(names):
            raise ValueError(f"its first line counts {rows[0][0] if rows else 0} images, {len(names)} follow")
    except (ValueError, IndexError) as error:
        raise UserError(path, f"is no Middlebury camera file ({error})", "copy it again from its source") from None

    def camera(index: int, size: Size) -> Camera:
        k, pose = matrices[index]
        return Camera(*size, k[0, 0], k[1, 1], k[0, 2], k[1, 2], pose)

    return CameraTable(path, "Middlebury", tuple(names), len(names), camera, (path,))
