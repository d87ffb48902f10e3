"""A mesh unwrapped into one rectangle of texels (xatlas)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError

from .atlas_kernel import rasterise

PADDING = 4
"""Texels between charts: two levels of smaller textures are free of their neighbours' colour."""
SMALLEST = 16
MOST_FACES = 4096
"""Of a part that is cut into charts on its own: xatlas's time grows faster than the triangles (48 000 as one: 8.3 s, in sixteen
parts 4.5 s and a texture of 4 % more)."""
TRIES = 12  # of fitting into the largest texture; the later half has a texel between charts
SHRINKING = 1.1  # least factor from try to try: padding does not shrink


@dataclass(frozen=True)
class Atlas:
    """A mesh cut up and laid out in a rectangle.

    Fields:
        source: the mesh's vertex behind each of the atlas's. [W]
        faces: of the atlas's vertices, in the mesh's order. [F, 3]
        uv: in 0..1, v from the top row down, as in glTF. [W, 2]
        width, height: in texels.
    """

    source: NDArray[np.int64]
    faces: NDArray[np.int64]
    uv: NDArray[np.float64]
    width: int
    height: int


@dataclass(frozen=True)
class Texels:
    """The texels whose centres lie on the surface.

    Fields:
        index: into the flattened texture. [T]
        face: triangle of the atlas. [T]
        weights: of its corners. [T, 3]
    """

    index: NDArray[np.int64]
    face: NDArray[np.int64]
    weights: NDArray[np.float32]

    def of(self, values: NDArray, faces: NDArray) -> NDArray[np.float32]:
        """Values [W, C] of the vertices, interpolated at the texels [T, C]."""
        corners = faces[self.face]
        out = np.zeros((len(corners), values.shape[1]), np.float32)
        for k in range(3):
            out += self.weights[:, k, None] * values[corners[:, k]].astype(np.float32)
        return out


def unwrap(vertices: NDArray, faces: NDArray, texel: float, largest: int) -> Atlas:
    """Lay a mesh out in an atlas.

    Args:
        vertices: world units. [V, 3]
        faces: triangles. [F, 3]
        texel: a texel's side in world units; more where the texture would be longer than `largest`.
        largest: of the texture's sides (texels).

    Returns:
        The atlas, its faces in the mesh's order.

    Raises:
        UserError: it cannot be shrunk to `largest`.
    """
    for attempt in range(TRIES):
        atlas = _packed(vertices, faces, texel, PADDING if attempt < TRIES // 2 else 1)
        longest = max(atlas.width, atlas.height)
        if longest <= largest:
            return atlas
        texel *= max(SHRINKING, longest / largest)
    raise UserError(
        f"max_texture={largest}", f"{len(faces)} triangles do not fit into a texture of that size", "give a larger one"
    )


def _packed(vertices: NDArray, faces: NDArray, texel: float, padding: int) -> Atlas:
    import xatlas

    scale = 1.0 / texel  # in texels: xatlas drops triangles whose area looks like nothing to it
    low = vertices.min(0)
    atlas = xatlas.Atlas()
    part = parts_of(vertices[faces].mean(1), MOST_FACES)
    numbers = [np.flatnonzero(part == k) for k in range(int(part.max()) + 1)]
    used = []
    for number in numbers:
        ours, local = np.unique(faces[number], return_inverse=True)
        used.append(ours)
        position = np.ascontiguousarray((vertices[ours] - low) * scale, np.float32)
        atlas.add_mesh(position, np.ascontiguousarray(local.reshape(-1, 3), np.uint32))
    pack = xatlas.PackOptions()
    pack.texels_per_unit, pack.padding, pack.bilinear = 1.0, padding, True
    atlas.generate(xatlas.ChartOptions(), pack)
    width, height = (max(SMALLEST, n) for n in (atlas.width, atlas.height))
    source: list[NDArray[np.int64]] = []
    uv: list[NDArray] = []
    triangles = np.empty(faces.shape, np.int64)
    for k, number in enumerate(numbers):
        of, corners, at = atlas[k]
        triangles[number] = corners.astype(np.int64) + sum(len(part) for part in source)
        source.append(used[k][of])
        uv.append(at.astype(np.float64) * (atlas.width / width, atlas.height / height))
    return Atlas(np.concatenate(source), triangles, np.concatenate(uv), width, height)


def parts_of(points: NDArray, most: int) -> NDArray[np.int64]:
    """Cut points at the median of their longest side, again and again, until no part has more than `most`.

    Args:
        points: positions. [N, 3]
        most: points of a part.

    Returns:
        Each point's part, from 0. [N]
    """
    part = np.zeros(len(points), np.int64)
    for _ in range(max(0, int(np.ceil(np.log2(max(1, len(points)) / most))))):
        order = part * 2
        for k in range(int(part.max()) + 1):
            at = np.flatnonzero(part == k)
            along = points[at, np.ptp(points[at], axis=0).argmax()]
            order[at[np.argsort(along, kind="stable")[len(at) // 2 :]]] += 1
        part = order
    return part


def texels_of(atlas: Atlas) -> Texels:
    """Which texels the triangles cover, and where on them they lie.

    Args:
        atlas: a mesh laid out.

    Returns:
        The texels that have a triangle, by rows.
    """
    corners = np.ascontiguousarray((atlas.uv * (atlas.width, atlas.height))[atlas.faces])
    face = np.full(atlas.width * atlas.height, -1, np.int32)
    weights = np.zeros((len(face), 3), np.float32)
    rasterise(corners, atlas.width, atlas.height, face, weights)
    index = np.flatnonzero(face >= 0)
    return Texels(index, face[index].astype(np.int64), weights[index])
