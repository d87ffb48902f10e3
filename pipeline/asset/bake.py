"""Textures of a mesh from views of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.rays import RayMesh

from .ambient import sky_seen
from .atlas import Atlas, texels_of, unwrap
from .blending import blend
from .choice import Points
from .filling import from_neighbours, nearest_texel, texture
from .tangents import in_tangent_frame, vertex_tangents
from .views import PropertyViews

NORMAL, ALBEDO, ROUGHNESS, IOR = slice(0, 3), slice(3, 6), 6, 7
CHANNELS = 8
"""What a view's `values` hold: world normal, albedo R G B, roughness, index of refraction."""
GUESSED = 0.5
"""Coverage of texels that no view sees; 1: seen, 0: no surface."""


@dataclass(frozen=True)
class AtlasMesh:
    """A mesh in an atlas, with textures.

    position, normal [W, 3], tangent [W, 4] (`vertex_tangents`), faces [F, 3], uv [W, 2] (v from the top row down).
    maps [H, W, C] by name: albedo (3), roughness, normal (3, tangent space), ior, specular (reflectance at normal incidence),
    occlusion (share of the sky seen), coverage (1 seen, 0.5 guessed, 0 no surface).
    """

    position: NDArray[np.float64]
    normal: NDArray[np.float64]
    tangent: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: NDArray[np.float64]
    maps: dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class Textured(AtlasMesh):
    """What baking makes, in world units and axes; texel: a texel's size, guessed: share of texels that no view sees."""

    texel: float
    guessed: float


def bake(
    vertices: NDArray,
    faces: NDArray,
    normals: NDArray,
    views: PropertyViews,
    texel: float,
    largest: int,
    advance: Callable[[int], None] = lambda done: None,
) -> Textured:
    """Unwrap a mesh and blend views into its textures.

    Args:
        vertices, normals: world; normals unit, outward. [V, 3]
        faces: vertex numbers. [F, 3]
        views: `CHANNELS` values each.
        texel: a texel's side in world units: a pixel's footprint, for textures as sharp as the pictures.
        largest: side of the largest texture (texels).
        advance: told of views gone through, 2 len(views) in all.

    Returns:
        The surface in its atlas, with its maps.
    """
    atlas = unwrap(vertices, faces, texel, largest)
    position, normal = vertices[atlas.source], normals[atlas.source]
    tangent = vertex_tangents(position, normal, atlas)
    texels = texels_of(atlas)
    where, upright, along = (texels.of(v, atlas.faces) for v in (position, normal, tangent))
    upright /= np.maximum(np.linalg.norm(upright, axis=1, keepdims=True), 1e-12)
    spacing = _spacing(position, atlas)
    mesh = RayMesh(vertices, faces)
    values, detail, seen = blend(Points(where, upright, spacing), mesh, views, CHANNELS, advance)
    agrees = seen & ((values[:, NORMAL] * upright).sum(1) > 0)
    values[:, NORMAL] = np.where(agrees[:, None], values[:, NORMAL], upright)
    values = from_neighbours(values, seen, where)
    values[:, NORMAL] = np.where(seen[:, None], values[:, NORMAL], upright)
    values[:, ALBEDO] = np.clip(values[:, ALBEDO] * np.exp(detail), 0, 1)
    local = in_tangent_frame(values[:, NORMAL], upright, along)
    local /= np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-12)
    reflectance = ((values[:, IOR] - 1) / (values[:, IOR] + 1)) ** 2
    coverage = np.where(seen, 1.0, GUESSED)
    sky = sky_seen(mesh, where, upright, spacing)
    layers = {"albedo": values[:, ALBEDO], "normal": local, "roughness": values[:, ROUGHNESS], "ior": values[:, IOR]}
    layers |= {"specular": reflectance, "occlusion": sky}
    shape = (atlas.height, atlas.width)
    nearest = nearest_texel(texels.index, shape)
    maps = {name: texture(v.reshape(len(v), -1), texels.index, nearest, shape) for name, v in layers.items()}
    flat = np.zeros(atlas.width * atlas.height, np.float32)
    flat[texels.index] = coverage
    maps["coverage"] = flat.reshape(*shape, 1)
    return Textured(position, normal, tangent, atlas.faces, atlas.uv, maps, spacing, 1 - float(seen.mean()))


def _spacing(position: NDArray, atlas: Atlas) -> float:
    """World units between neighbouring texels: charts are stretched alike, so areas tell it."""
    a, b, c = (position[atlas.faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    p, q, r = (atlas.uv[atlas.faces[:, k]] * (atlas.width, atlas.height) for k in range(3))
    flat = np.abs((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0]).sum() / 2
    return float(np.sqrt(area / max(flat, 1e-12)))
