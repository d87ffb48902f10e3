"""Tangent frames on an atlas's vertices and texels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .atlas import Atlas


def vertex_tangents(positions: NDArray, normals: NDArray, atlas: Atlas) -> NDArray[np.float64]:
    """Tangents as glTF stores them: means of the triangles by their angle at the vertex, as MikkTSpace's.

    Args:
        positions: of the atlas's vertices. [W, 3]
        normals: unit. [W, 3]
        atlas: the mesh laid out.

    Returns:
        The direction in which u grows, unit, across the normal; and the sign that makes sign * (normal x tangent) the direction
        in which the picture's rows go up. [W, 4]
    """
    corners, at = positions[atlas.faces], atlas.uv[atlas.faces] * (atlas.width, -atlas.height)
    along_a, along_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (ua, va), (ub, vb) = np.moveaxis(at[:, 1] - at[:, 0], -1, 0), np.moveaxis(at[:, 2] - at[:, 0], -1, 0)
    area = ua * vb - ub * va
    turned = np.where(area < 0, -1.0, 1.0)[:, None]
    towards_u = turned * (along_a * vb[:, None] - along_b * va[:, None])
    total, sign = np.zeros(positions.shape), np.zeros(len(positions))
    for k in range(3):
        index = atlas.faces[:, k]
        n = normals[index]
        flat = _unit(towards_u - n * (towards_u * n).sum(1, keepdims=True))
        angle = _angle(corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k])
        for axis in range(3):
            total[:, axis] += np.bincount(index, angle * flat[:, axis], len(positions))
        sign += np.bincount(index, angle * turned[:, 0], len(positions))
    total -= normals * (total * normals).sum(1, keepdims=True)
    tangent = _unit(total)
    lost = np.linalg.norm(tangent, axis=1) < 0.5  # vertices of triangles without area in the atlas
    if lost.any():
        axis = np.eye(3)[np.abs(normals[lost]).argmin(1)]
        tangent[lost] = _unit(np.cross(normals[lost], axis))
    return np.concatenate([tangent, np.where(sign < 0, -1.0, 1.0)[:, None]], 1)


def in_tangent_frame(world: NDArray, normal: NDArray, tangent: NDArray) -> NDArray[np.float32]:
    """World vectors by their parts along tangent, bitangent and normal.

    Args:
        world: vectors. [T, 3]
        normal: interpolated, of any length. [T, 3]
        tangent: interpolated, `vertex_tangents`. [T, 4]

    Returns:
        The parts. [T, 3]
    """
    n = _unit(normal)
    t = _unit(tangent[:, :3] - n * (tangent[:, :3] * n).sum(1, keepdims=True))
    b = np.cross(n, t) * np.where(tangent[:, 3:] < 0, -1.0, 1.0)
    return np.stack([(world * axis).sum(1) for axis in (t, b, n)], -1).astype(np.float32)


def _unit(vectors: NDArray) -> NDArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 1e-20)


def _angle(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(1))
