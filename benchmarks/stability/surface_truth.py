"""How far a run's mesh lies from the shape that its pictures were rendered from, where some view sees it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.stability.extreme_scenes import SCENES, WORLDS
from pipeline.formats.ply import Ply
from pipeline.geometry.rays import RayMesh
from pipeline.geometry.world_offset import stored_offset

NEARER = 1e-3  # of a vertex' distance: what is hit so much before it hides it


def seen_error_pct(capture: Path, name: str, mesh: Path) -> float:
    """Compute the median distance from the true surface, where a view sees it, to a mesh.

    Args:
        capture: of the case, with its transforms.json.
        name: of the case.
        mesh: PLY file in the capture's world.

    Returns:
        Percent of the true shape's longest side.
    """
    shape = SCENES.get(name, SCENES["base"]).shape()
    scale, shift = WORLDS.get(name, (1.0, 0.0))
    table = json.loads((capture / "transforms.json").read_text())
    centres = (np.array([frame["transform_matrix"] for frame in table["frames"]])[:, :3, 3] - shift) / scale
    points = shape.vertices[seen(shape.vertices, shape.faces, centres)]
    found = Ply(mesh)
    vertices = (found.vertices() + stored_offset(mesh) - shift) / scale
    away = np.linalg.norm(points - RayMesh(vertices, found.triangles()).closest(points).position, axis=1)
    return float(100 * np.median(away) / np.ptp(shape.vertices, axis=0).max())


def seen(vertices: NDArray, faces: NDArray, centres: NDArray) -> NDArray[np.bool_]:
    """Which vertices [V, 3] no part of their mesh hides from every one of some centres [C, 3]."""
    scene, out = RayMesh(vertices, faces), np.zeros(len(vertices), bool)
    for centre in centres:
        towards = vertices - centre
        distance = np.linalg.norm(towards, axis=1)
        first = scene.distance(centre[None], towards / distance[:, None])
        out |= first > distance * (1 - NEARER)
    return out
