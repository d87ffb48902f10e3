"""A sparse model on disk: COLMAP's text files and a point cloud."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.colmap import parameters_of
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import Camera
from pipeline.geometry.world_offset import ply_comment

FRAME_SUFFIX = ".exr"
"""Of the frames that decode wrote, in whose folder sparse/ finds its images."""


def quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation matrix [3, 3]; stable for every angle.

    The eigenvector of the largest eigenvalue of Bar-Itzhack's matrix (2000).
    """
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    _, vectors = np.linalg.eigh(k / 3.0)
    x, y, z, w = vectors[:, -1]
    q = np.array([w, x, y, z])
    return q if w >= 0 else -q


def write_sparse(folder: Path, cameras: Mapping[str, Camera], points: NDArray[np.float64] | None = None,
                 colours: NDArray[np.uint8] | None = None, suffix: str = "",
                 offset: NDArray[np.float64] | None = None) -> None:  # fmt: skip
    """COLMAP text model of cameras by VIEW (image NAME is VIEW + `suffix`); points [N, 3] without tracks.

    `offset` [3] is what was taken from all positions: a comment tells it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ids: dict[tuple[object, ...], int] = {}
    camera_lines, image_lines = [], []
    for number, (view, c) in enumerate(sorted(cameras.items()), 1):
        model, numbers = parameters_of(c)
        key = (c.name, model, c.width, c.height, *numbers)
        if key not in ids:
            ids[key] = len(ids) + 1
            camera_lines.append(f"{ids[key]} {model} {c.width} {c.height} {' '.join(repr(float(x)) for x in numbers)}")
        q, t = quaternion(c.world_to_camera[:3, :3]), c.world_to_camera[:3, 3]
        pose = " ".join(repr(float(x)) for x in (*q, *t))
        image_lines.append(f"{number} {pose} {ids[key]} {view}{suffix}\n")
    (folder / "cameras.txt").write_text("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n" + "\n".join(camera_lines) + "\n")
    (folder / "images.txt").write_text(
        "".join(f"# {line.removeprefix('comment ')}\n" for line in ply_comment(offset))
        + "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n"
        + "\n".join(image_lines)
        + "\n",
        encoding="utf-8",
    )
    lines = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    if points is not None:
        rgb = np.full((len(points), 3), 128, np.uint8) if colours is None else colours
        lines += [
            f"{i} {p[0]!r} {p[1]!r} {p[2]!r} {c[0]} {c[1]} {c[2]} 0"
            for i, (p, c) in enumerate(zip(points.tolist(), rgb.tolist()), 1)
        ]
    (folder / "points3D.txt").write_text("\n".join(lines) + "\n")


def write_points(
    path: Path, points: NDArray[np.float64], colours: NDArray[np.uint8], offset: NDArray[np.float64] | None = None
) -> None:
    """Binary PLY of points [N, 3] with 8-bit colours [N, 3], in the order given; `offset` [3] was taken from them."""
    columns = dict(zip("xyz", points.T)) | dict(zip(("red", "green", "blue"), colours.T))
    write_ply(path, columns, comments=ply_comment(offset))
