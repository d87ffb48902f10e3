"""PLY meshes and point clouds, in and out: ascii and binary of either byte order, any properties in any order.

The format is Greg Turk's "The PLY Polygon File Format" (Stanford, 1994). What the pipeline writes is binary little-endian
with float and uchar properties, as Blender, MeshLab, Open3D and viewers of Gaussians read it; what it reads may come from any
program. Triangle strips are refused: no current program writes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.ply_elements import PlyFault, parse
from pipeline.geometry.polygons import triangulated

CORNERS = ("vertex_indices", "vertex_index")
TEXT_DIGITS = 6
"""Significant digits of numbers written as text."""


class Ply:
    """What a PLY file holds; opening it reads and checks all of it."""

    def __init__(self, path: Path) -> None:
        """Read and check a file.

        Args:
            path: the PLY.

        Raises:
            UserError: there is no such file, or it is damaged or no PLY.
        """
        self.path = path
        if not path.is_file():
            raise UserError(path, "no such file", "check the path and the name")
        try:
            self.elements = {e.name: e for e in parse(path.read_bytes())}
        except OSError as error:
            raise UserError(path, f"cannot be read ({error.strerror})", "check its permissions") from error
        except PlyFault as fault:
            raise UserError(path, *fault.args) from None

    def vertices(self, names: Sequence[str] = ("x", "y", "z")) -> NDArray[np.float64]:
        """The named properties of every vertex, [V, len(names)]. Raises UserError where one is missing."""
        vertex = self.elements.get("vertex")
        if vertex is None:
            raise UserError(self.path, "has no element vertex", "export the mesh or points again")
        missing = [n for n in names if n not in vertex.columns]
        if missing:
            known = ", ".join(vertex.columns) or "none"
            raise UserError(self.path, f"its vertices have no {', '.join(missing)} (they have {known})", "export it with these")
        return np.stack([vertex.columns[n].astype(np.float64) for n in names], -1)

    def triangles(self) -> NDArray[np.int64]:
        """The faces as triangles [F, 3] of vertex numbers, polygons cut up; [0, 3] where there is none. Raises UserError."""
        if "tristrips" in self.elements:
            raise UserError(self.path, "holds triangle strips", "export it with faces (triangles)")
        face = self.elements.get("face")
        name = None if face is None else next((n for n in CORNERS if n in face.lists), None)
        if face is None or (name is None and not face.count):
            return np.zeros((0, 3), np.int64)
        if name is None:
            raise UserError(self.path, "its faces have no list vertex_indices", "export it again")
        lengths, corners = face.lists[name]
        corners = corners.astype(np.int64)
        count = len(self.vertices())
        if len(corners) and (corners.min() < 0 or corners.max() >= count):
            wrong = int(corners.min() if corners.min() < 0 else corners.max())
            raise UserError(self.path, f"a face names vertex {wrong} of {count}", "the file is damaged: export it again")
        if (lengths == 3).all():
            return corners.reshape(-1, 3)
        return triangulated(lengths, corners, self.vertices())


def write_ply(
    path: Path, vertices: Mapping[str, NDArray], faces: NDArray | None = None, text: bool = False, comments: Sequence[str] = ()
) -> None:
    """Write a mesh or a cloud of points.

    Args:
        path: the file; its folder is made.
        vertices: property to its values; uint8 becomes uchar, all else float (32 bits). [V] each
        faces: vertex numbers of triangles; None: no faces. [F, 3]
        text: write ascii with TEXT_DIGITS significant digits, instead of binary little-endian.
        comments: lines for the header.
    """
    columns = {n: np.asarray(c) for n, c in vertices.items()}
    columns = {n: c if c.dtype == np.uint8 else c.astype("<f4" if not text else np.float64) for n, c in columns.items()}
    count = len(next(iter(columns.values())))
    head = ["ply", f"format {'ascii' if text else 'binary_little_endian'} 1.0"]
    head += [*(f"comment {c}" for c in comments), f"element vertex {count}"]
    head += [f"property {'uchar' if c.dtype == np.uint8 else 'float'} {n}" for n, c in columns.items()]
    if faces is not None:
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    head.append("end_header")
    path.parent.mkdir(parents=True, exist_ok=True)
    if text:
        rows = [" ".join(f"{x:.{TEXT_DIGITS}g}" for x in row) for row in zip(*columns.values())]
        corners = [] if faces is None else [f"3 {a} {b} {c}" for a, b, c in faces]
        path.write_text("\n".join([*head, *rows, *corners]) + "\n")
        return
    table = np.empty(count, [(n, c.dtype.str) for n, c in columns.items()])
    for n, c in columns.items():
        table[n] = c
    triangles = np.empty(0 if faces is None else len(faces), [("n", "u1"), ("v", "<i4", (3,))])
    if faces is not None:
        triangles["n"], triangles["v"] = 3, faces
    path.write_bytes("\n".join([*head, ""]).encode() + table.tobytes() + triangles.tobytes())
