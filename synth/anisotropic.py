"""Light-stage captures of strongly anisotropic surfaces, with noise and clipped highlights: harder than the tiny demo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError

from .shape import Shape, vase, vertex_normals
from .stage_capture import Subject, make

WIDTHS = (0.12, 0.4)  # Beckmann widths along u and v
NOISE, CLIP = 3e-3, 2.0
SPP = 25  # samples a pixel: what one sees of a pixel's faces
RUBBLE_FACES = (260, 200)  # around, along: some thirty faces in a pixel of a frame 85 pixels high
BUMP_SLOPE = 0.06  # root mean square slope of the bumps (rad), finer than a pixel


def scenes(meshes: list[Path]) -> dict[str, Subject]:
    """Make the captures' subjects: `brushed`, tangents that run round the vase; `rubble`, each face its own; one for each mesh.

    Args:
        meshes: PLY files.

    Returns:
        Name to subject.
    """
    common = {"sigma": WIDTHS, "specular": 0.35, "noise": NOISE, "clip": CLIP}
    found = {
        "brushed": Subject(vase(), **common),  # type: ignore[arg-type]
        "rubble": Subject(rubble(), textured=False, **common),  # type: ignore[arg-type]
    }
    return {**found, **{path.stem: Subject(read_mesh(path), textured=False, **common) for path in meshes}}  # type: ignore[arg-type]


def build(output: Path, name: str, meshes: list[Path], size: int, lights: int, seed: int) -> None:
    """Write one of the captures of `scenes`.

    Args:
        output: folder.
        name: of the capture.
        meshes: PLY files that `scenes` is given.
        size: of the frames, pixels.
        lights: how many.
        seed: of noise and sampling.
    """
    make(output, size=size, lights=lights, spp=SPP, seed=seed, subject=scenes(meshes)[name])


def rubble(seed: int = 0) -> Shape:
    """The vase with fine bumps, its faces' first edges (their tangents) turned at random."""
    rng = np.random.default_rng(seed)
    shape = vase(*RUBBLE_FACES)
    waves = rng.normal(size=(40, 3))
    waves *= rng.uniform(60, 120, (40, 1)) / np.linalg.norm(
        waves, axis=1, keepdims=True
    )  # per unit of length; the vase is 2 high
    phase = rng.uniform(0, 2 * np.pi, 40)
    height = np.sin(shape.vertices @ waves.T + phase) @ (BUMP_SLOPE / 90 * np.full(40, np.sqrt(2 / 40)))
    vertices = shape.vertices + height[:, None] * shape.normals
    turned = np.stack([np.roll(face, turn) for face, turn in zip(shape.faces, rng.integers(3, size=len(shape.faces)))])
    return replace(shape, vertices=vertices, normals=_normals(vertices, shape.faces), faces=turned.astype(np.int32))


def _normals(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Vertex normals; vertices of one place (a texture's seam) share theirs."""
    _, first, place = np.unique(vertices.round(6), axis=0, return_index=True, return_inverse=True)
    welded = first[place.ravel()]
    return vertex_normals(vertices, welded[faces])[welded]


def read_mesh(path: Path) -> Shape:
    """A triangle mesh file, centred and scaled to a height of 2. Raises UserError."""
    import open3d as o3d

    mesh = o3d.io.read_triangle_mesh(str(path))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    if not len(faces):
        raise UserError(path, "holds no triangle", "give a PLY, OBJ or STL triangle mesh")
    low, high = vertices.min(0), vertices.max(0)
    vertices = (vertices - (low + high) / 2) * (2 / np.max(high - low))
    return Shape(vertices, vertex_normals(vertices, faces), np.zeros((len(vertices), 2)), faces.astype(np.int32))
