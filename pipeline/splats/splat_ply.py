"""PLY files of 3D Gaussian splatting, as its authors' program writes them and viewers read them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.formats.ply import Ply, write_ply

from .cloud import SplatCloud
from .harmonics import COEFFICIENTS

POSITION = ("x", "y", "z")
SCALES, ROTATION = tuple(f"scale_{k}" for k in range(3)), tuple(f"rot_{k}" for k in range(4))
CONSTANT, REST = tuple(f"f_dc_{k}" for k in range(3)), tuple(f"f_rest_{k}" for k in range(3 * (COEFFICIENTS - 1)))
"""Coefficients: all of red, then green, then blue."""


def write_splat_ply(path: Path, cloud: SplatCloud, comments: Sequence[str] = ()) -> None:
    """Write a cloud, degree 3; normals are the third axes (viewers take no notice).

    Args:
        path: the file.
        cloud: as it is, in whatever axes.
        comments: lines for the header.
    """
    w, x, y, z = cloud.quaternions.T
    normal = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
    rest = np.moveaxis(cloud.coefficients[:, 1:], 1, 2).reshape(len(cloud), -1)
    parts = (
        (POSITION, cloud.means), (("nx", "ny", "nz"), normal), (CONSTANT, cloud.coefficients[:, 0]), (REST, rest),
        (("opacity",), cloud.opacity[:, None]), (SCALES, cloud.log_scales), (ROTATION, cloud.quaternions),
    )  # fmt: skip
    write_ply(path, {n: values[:, k] for names, values in parts for k, n in enumerate(names)}, comments=comments)


def read_splat_ply(path: Path) -> SplatCloud:
    """Read a cloud.

    Args:
        path: a PLY of 3D Gaussian splatting, of degree 0 or 3.

    Returns:
        What it holds; coefficients that it has not are 0.

    Raises:
        UserError: it is another kind of PLY, or damaged.
    """
    ply = Ply(path)
    columns = ply.elements["vertex"].columns if "vertex" in ply.elements else {}
    coefficients = np.zeros((len(ply.vertices()), COEFFICIENTS, 3))
    coefficients[:, 0] = ply.vertices(CONSTANT)
    if REST[0] in columns:
        coefficients[:, 1:] = np.moveaxis(ply.vertices(REST).reshape(-1, 3, COEFFICIENTS - 1), 1, 2)
    rotation = ply.vertices(ROTATION)
    rotation = rotation / np.maximum(np.linalg.norm(rotation, axis=1, keepdims=True), 1e-12)
    return SplatCloud(ply.vertices(), rotation, ply.vertices(SCALES), ply.vertices(("opacity",))[:, 0], coefficients)
