"""The objects of the synthetic captures, from formulas: a bent, fluted vase with a waist and a bowl in its crown; a bowl."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

# Half profile (radius, height) from the south pole up the outside, over the rim and down into the bowl.
PROFILE = np.array([
    (0.00, -1.00), (0.22, -1.00), (0.40, -0.97), (0.52, -0.86), (0.62, -0.66), (0.66, -0.42), (0.60, -0.14),
    (0.46, 0.12), (0.37, 0.34), (0.40, 0.56), (0.53, 0.78), (0.60, 0.92), (0.56, 0.99), (0.46, 0.96),
    (0.33, 0.80), (0.18, 0.68), (0.00, 0.65),
])  # fmt: skip
# The same of a bowl as deep as it is wide: what it sends to itself is most of its light when it is white.
BOWL = np.array([
    (0.00, -0.80), (0.35, -0.76), (0.68, -0.55), (0.90, -0.15), (0.98, 0.30), (1.00, 0.62), (0.96, 0.68), (0.90, 0.62),
    (0.88, 0.30), (0.80, -0.10), (0.60, -0.45), (0.30, -0.64), (0.00, -0.68),
])  # fmt: skip
FLUTES = 5
FLUTE_DEPTH = 0.11  # of the radius
TWIST = 1.1  # radians of flute rotation per unit of height
BEND = 0.09  # sideways offset of the axis
GLAZE = np.array([0.70, 0.16, 0.06])  # terracotta, linear RGB reflectance
SLIP = np.array([0.10, 0.28, 0.52])  # blue, in one swirl


@dataclass(frozen=True)
class Shape:
    """A closed triangle mesh, cut along one seam for its texture.

    Fields:
        vertices: positions. [V, 3]
        normals: unit, outward. [V, 3]
        uv: texture coordinates, 0..1. [V, 2]
        faces: vertex numbers. [F, 3]
    """

    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64]
    faces: NDArray[np.int32]

    def scaled(self, factor: float) -> Shape:
        """The same shape `factor` times as large."""
        return replace(self, vertices=self.vertices * factor)


def vase(around: int = 160, along: int = 120) -> Shape:
    """Make a fluted vase of height 2 about the origin, y up; u runs around, v from foot to bowl.

    Args:
        around, along: quads around the axis and along the profile.

    Returns:
        The mesh.
    """
    return _turned(around, along, _surface)


def bowl(around: int = 96, along: int = 96) -> Shape:
    """Make a round bowl of radius 1 about the y axis, open towards +y.

    Args:
        around, along: quads around the axis and along the profile.

    Returns:
        The mesh.
    """
    return _turned(around, along, _bowl_surface)


def _turned(around: int, along: int, surface: Callable[[NDArray, NDArray], NDArray]) -> Shape:
    """Shape of a surface over (u around, v along) whose ends v = 0 and 1 are poles."""
    u = np.arange(around + 1) / around
    v = np.linspace(0.0, 1.0, along + 1)
    vertices = surface(u[None, :], v[:, None])  # [along + 1, around + 1, 3], first = last column, poles repeated
    vertices[:, -1] = vertices[:, 0]
    vertices[0], vertices[-1] = vertices[0, 0], vertices[-1, 0]

    corner = np.arange((along + 1) * (around + 1)).reshape(along + 1, around + 1)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    lower = np.stack([a, b, c], -1)[1:].reshape(-1, 3)  # at the south pole a = b: no triangle
    upper = np.stack([b, d, c], -1)[:-1].reshape(-1, 3)  # at the north pole c = d
    faces = np.concatenate([lower, upper]).astype(np.int32)

    welded = np.arange(corner.size).reshape(corner.shape)
    welded[:, -1] = welded[:, 0]
    welded[0], welded[-1] = welded[0, 0], welded[-1, 0]
    normals = vertex_normals(vertices.reshape(-1, 3), welded.ravel()[faces])[welded.ravel()]
    uv = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), -1).reshape(-1, 2)
    return Shape(vertices.reshape(-1, 3), normals, uv, faces)


def _surface(u: NDArray, v: NDArray) -> NDArray[np.float64]:
    """Points [..., 3] of the vase at parameters u (around) and v (along the profile), both in [0, 1]."""
    radius, height = _profile(PROFILE, v)
    azimuth = 2 * np.pi * u
    fade = np.clip(np.minimum(v, 1 - v) / 0.22, 0, 1) ** 2  # flutes would pinch at the poles
    radius = radius * (1 + FLUTE_DEPTH * fade * np.cos(FLUTES * (azimuth + TWIST * height)))
    x, y, z = radius * np.cos(azimuth) + BEND * np.sin(2 * height), height, radius * np.sin(-azimuth)
    return np.stack(np.broadcast_arrays(x, y, z), -1).copy()


def _profile(points: NDArray, v: NDArray) -> NDArray[np.float64]:
    """Radius and height [2, ...] at v in [0, 1] along a smooth curve through points [N, 2] from pole to pole."""
    from scipy.interpolate import CubicSpline

    steps = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    # Level at both poles, so that the surface is smooth there.
    ends = ((1, np.array([steps[-1], 0.0])), (1, np.array([-steps[-1], 0.0])))
    return np.moveaxis(CubicSpline(steps / steps[-1], points, bc_type=ends)(v), -1, 0)


def _bowl_surface(u: NDArray, v: NDArray) -> NDArray[np.float64]:
    """Points [..., 3] of the bowl, as `_surface`."""
    radius, height = _profile(BOWL, v)
    azimuth = 2 * np.pi * u
    x, y, z = radius * np.cos(azimuth), height, radius * np.sin(-azimuth)
    return np.stack(np.broadcast_arrays(x, y, z), -1).copy()


def glaze(height: int = 256) -> NDArray[np.float32]:
    """Compute the vase's albedo at uv = ((column + 1/2) / width, (row + 1/2) / height).

    Args:
        height: texels; the width is twice that.

    Returns:
        Linear RGB. [height, 2 height, 3]
    """
    u = (np.arange(2 * height) + 0.5) / (2 * height)
    v = (np.arange(height)[:, None] + 0.5) / height
    azimuth = 2 * np.pi * u
    swirl = np.cos(azimuth - 9 * v) + 0.25 * np.cos(3 * azimuth + 20 * v) - 0.55
    poles = np.clip(np.minimum(v, 1 - v) / 0.15, 0, 1)
    blend = (poles / (1 + np.exp(-14 * swirl)))[..., None]
    return (GLAZE * (1 - blend) + SLIP * blend).astype(np.float32)


def vertex_normals(vertices: NDArray, faces: NDArray) -> NDArray[np.float64]:
    """Compute vertex normals as area-weighted means of the faces'.

    Args:
        vertices: positions. [V, 3]
        faces: vertex numbers. [F, 3]

    Returns:
        Unit; 0 for vertices that no face uses. [V, 3]
    """
    corner = vertices[faces]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], face)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
