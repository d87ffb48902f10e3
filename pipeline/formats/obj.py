"""Wavefront OBJ: vertices and faces, all that a true surface is read for."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError


def read_obj(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read the surface of all groups together; faces of more corners become fans.

    Args:
        path: an OBJ file.

    Returns:
        Vertices [V, 3] and triangles [F, 3].

    Raises:
        UserError: the file cannot be read, is no OBJ mesh, or has a face of a vertex that is not there.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    try:
        with path.open(encoding="utf-8", errors="replace") as stream:
            for line in stream:
                words = line.split()
                if words[:1] == ["v"]:
                    vertices.append([float(w) for w in words[1:4]])
                elif words[:1] == ["f"]:
                    corners = [_index(w, len(vertices)) for w in words[1:]]
                    triangles += [(corners[0], a, b) for a, b in pairwise(corners[1:])]
        points, faces = np.array(vertices, np.float64).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3)
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the file and its permissions") from error
    except (ValueError, IndexError) as error:
        raise UserError(path, f"is no OBJ mesh ({error})", "export it again, or remove it") from error
    if len(faces) and (faces.min() < 0 or faces.max() >= len(points)):
        raise UserError(path, "has a face of a vertex that is not there", "export it again, or remove it")
    return points, faces


def _index(word: str, known: int) -> int:
    """The number from 0 of a face's corner `v`, `v/vt`, `v//vn` or `v/vt/vn`; a negative v counts back from the latest."""
    number = int(word.partition("/")[0])
    return number - 1 if number > 0 else known + number
