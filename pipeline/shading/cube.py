"""Cube maps: geometry of the six faces, and bilinear lookup without seams.

Faces in the order +x -x +y -y +z -z; texel (row j, column i) of face f lies at N_f + u U_f + v V_f with
u = (2i+1)/R - 1, v = (2j+1)/R - 1. A texel holds the mean radiance over its solid angle.

Lookups read an *extended* table of 6 R^2 + 8 rows: the texels, then for each of the cube's corners the mean of
the three texels that meet there. A padded index table sends the ring around a face to its neighbours' texels,
so that interpolation is continuous over edges and corners.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray

CORNERS = 8

# [6, 3 (N, U, V), 3]: OpenGL's cube-map axes.
AXES = np.array(
    [
        [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
        [[-1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, -1]],
        [[0, 0, 1], [1, 0, 0], [0, -1, 0]],
        [[0, 0, -1], [-1, 0, 0], [0, -1, 0]],
    ],
    dtype=np.float64,
)


def extended_size(resolution: int) -> int:
    """Rows of the extended table: texels and corners."""
    return 6 * resolution * resolution + CORNERS


def cube_directions(resolution: int) -> NDArray[np.float64]:
    """Compute the directions of a cube's texel centres.

    Args:
        resolution: R, texels on a face's side.

    Returns:
        Unit. [6, R, R, 3]
    """
    t = (2 * np.arange(resolution) + 1) / resolution - 1
    n, u, v = (AXES[:, k, None, None, :] for k in range(3))
    d = n + t[None, None, :, None] * u + t[None, :, None, None] * v
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def face_coordinates(directions: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray, NDArray]:
    """Face and (u, v) in [-1, 1] that each direction [..., 3] pierces."""
    axis = np.argmax(np.abs(directions), axis=-1)
    major = np.take_along_axis(directions, axis[..., None], -1)[..., 0]
    face = 2 * axis + (major < 0)
    u = np.sum(directions * AXES[face, 1], -1) / np.abs(major)
    v = np.sum(directions * AXES[face, 2], -1) / np.abs(major)
    return face, u, v


def texel_of(directions: NDArray[np.float64], resolution: int) -> NDArray[np.int64]:
    """Flat index of the texel that each direction [..., 3] falls in."""
    face, u, v = face_coordinates(directions)
    i, j = (np.clip(((t + 1) / 2 * resolution).astype(np.int64), 0, resolution - 1) for t in (u, v))
    return (face * resolution + j) * resolution + i


@lru_cache(maxsize=32)
def padded_indices(resolution: int) -> NDArray[np.int32]:
    """Rows of the extended table [6, R+2, R+2]: each face's texels with a ring of its neighbours'."""
    r = resolution
    t = (2 * np.arange(-1, r + 1) + 1) / r - 1
    n, u, v = (AXES[:, k, None, None, :] for k in range(3))
    d = n + t[None, None, :, None] * u + t[None, :, None, None] * v
    table = texel_of(d, r)
    for j in (0, -1):
        for i in (0, -1):
            table[:, j, i] = 6 * r * r + _corner_id(d[:, j, i])
    return table.astype(np.int32)


def _corner_id(directions: NDArray[np.float64]) -> NDArray[np.int64]:
    return ((directions > 0) * np.array([1, 2, 4])).sum(-1)


@lru_cache(maxsize=32)
def corner_texels(resolution: int) -> NDArray[np.int64]:
    """The three texels that meet at each corner [8, 3]."""
    r = resolution
    found: list[list[int]] = [[] for _ in range(CORNERS)]
    for face in range(6):
        for j, b in ((0, -1), (r - 1, 1)):
            for i, a in ((0, -1), (r - 1, 1)):
                corner = AXES[face, 0] + a * AXES[face, 1] + b * AXES[face, 2]
                found[int(_corner_id(corner))].append((face * r + j) * r + i)
    return np.array(found)


def extend(texels: torch.Tensor) -> torch.Tensor:
    """Extended table [6 R^2 + 8, C] of a cube [6, R, R, C]."""
    resolution = texels.shape[1]
    flat = texels.reshape(6 * resolution * resolution, -1)
    corners = torch.as_tensor(corner_texels(resolution), device=texels.device)
    return torch.cat((flat, flat[corners].mean(1)))


def lookup(table: torch.Tensor, directions: torch.Tensor, resolution: int) -> torch.Tensor:
    """Bilinear lookup of an extended table [6 R^2 + 8, C] in directions [P, 3] (any length) -> [P, C]."""
    return lookup_at(table, directions, resolution, _rows_on(resolution, table.device), 0)


def lookup_at(
    table: torch.Tensor,
    directions: torch.Tensor,
    resolution: torch.Tensor | int,
    rows: torch.Tensor,
    begin: torch.Tensor | int,
) -> torch.Tensor:
    """Bilinear lookup in extended tables that lie one after another, each direction in its own.

    Args:
        table: the tables' rows. [T, C]
        directions: any length. [P, 3]
        resolution: of the table that a direction is looked up in. [P], or one for all
        rows: the tables' `padded_indices`, flat, as rows of `table`. [B]
        begin: where those of a direction's table begin in `rows`. [P], or one for all

    Returns:
        Values, differentiable in table and directions. [P, C]
    """
    face, u, v = _torch_face_coordinates(directions)
    s = (u + 1) * (resolution / 2) + 0.5
    t = (v + 1) * (resolution / 2) + 0.5
    # Clamped as integers, so that a direction that is not finite reads somewhere, to no finite value.
    most = torch.as_tensor(resolution, device=s.device)
    i, j = (torch.minimum(x.detach().floor().long().clamp_min(0), most) for x in (s, t))
    s, t = (s - i)[:, None], (t - j)[:, None]
    width = resolution + 2
    first = begin + (face * width + j) * width + i
    second = first + width
    corner = [table.index_select(0, rows[k]) for k in (first, first + 1, second, second + 1)]
    top = corner[0] * (1 - s) + corner[1] * s
    bottom = corner[2] * (1 - s) + corner[3] * s
    return top * (1 - t) + bottom * t


@lru_cache(maxsize=32)
def _rows_on(resolution: int, device: torch.device) -> torch.Tensor:
    """`padded_indices`, flat, copied to a device once."""
    return torch.as_tensor(padded_indices(resolution), device=device).long().reshape(-1)


@lru_cache(maxsize=4)
def _axes_on(device: torch.device) -> torch.Tensor:
    """`AXES`, float64, copied to a device once."""
    return torch.as_tensor(AXES, device=device)


def texel_index(directions: torch.Tensor, resolution: int) -> torch.Tensor:
    """Texels [P] that directions [P, 3] (any length) fall in."""
    face, u, v = _torch_face_coordinates(directions)
    i, j = (((t + 1) * (resolution / 2)).long().clamp(0, resolution - 1) for t in (u, v))
    return (face * resolution + j) * resolution + i


def _torch_face_coordinates(d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    axes = _axes_on(d.device).to(d.dtype)
    magnitude = d.detach().abs()
    axis = magnitude.argmax(-1)
    major = d.gather(-1, axis[:, None])[:, 0]
    face = 2 * axis + (major.detach() < 0)
    # The floor only meets the zero vector, whose lookup is any finite value.
    inverse = 1 / major.abs().clamp_min(torch.finfo(d.dtype).tiny ** 0.25)
    u = (d * axes[face, 1]).sum(-1) * inverse
    v = (d * axes[face, 2]).sum(-1) * inverse
    return face, u, v
