"""Binary PLY triangle meshes with named float vertex properties, as Blender, MeshLab and Open3D read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.world import ply_comment


def write_ply(
    path: Path,
    names: list[str],
    values: NDArray,
    colour: NDArray[np.uint8],
    faces: NDArray,
    offset: NDArray[np.float64] | None = None,
) -> None:
    """Write vertices (float properties `names`, values [V, n], colour [V, 3]) and triangles [F, 3].

    `offset` [3] was taken from all world positions (`pipeline.geometry.world`): a comment tells it.
    """
    vertex = np.dtype([(n, "<f4") for n in names] + [(c, "u1") for c in ("red", "green", "blue")])
    rows = np.empty(len(values), vertex)
    for k, name in enumerate(names):
        rows[name] = values[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        rows[name] = colour[:, k]
    triangles = np.empty(len(faces), np.dtype([("n", "u1"), ("v", "<i4", (3,))]))
    triangles["n"], triangles["v"] = 3, faces
    head = ["ply", "format binary_little_endian 1.0", *ply_comment(offset), f"element vertex {len(rows)}"]
    head += [f"property float {n}" for n in names] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(head).encode() + rows.tobytes() + triangles.tobytes())
