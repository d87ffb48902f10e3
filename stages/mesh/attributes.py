"""Material and normals on vertices, from the views that see them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.mesh import Mesh

from .gbuffer import DepthView

NAMES = ("albedo_r", "albedo_g", "albedo_b", "roughness", "ior")


def bake(mesh: Mesh, views: Iterable[DepthView], tolerance: float) -> tuple[Mesh, float]:
    """The mesh with `normal` [V, 3] and `material` [V, 5], and the fraction of vertices that some view sees.

    A view counts where its depth agrees with the vertex within `tolerance`, by the fourth power of the facing cosine
    (square views are sharp ones). Vertices that nobody sees take the nearest seen one's material and keep their
    geometric normal.
    """
    from scipy.spatial import cKDTree

    geometric = mesh.normals()
    total = np.zeros((len(mesh.vertices), 8))
    weight = np.zeros(len(mesh.vertices))
    offset = (geometric * mesh.vertices).sum(1)
    for view in views:
        front = np.flatnonzero(geometric @ view.camera.centre > offset)
        pixels, z = view.camera.project(mesh.vertices[front])
        height, width = view.depth.shape
        with np.errstate(invalid="ignore"):
            column, row = np.floor(pixels[:, 0]), np.floor(pixels[:, 1])
            inside = (z > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
        at, z = front[inside], z[inside]
        r, c = row[inside].astype(np.int64), column[inside].astype(np.int64)
        depth = view.depth[r, c]
        towards = view.camera.centre - mesh.vertices[at]
        towards /= np.sqrt((towards**2).sum(1, keepdims=True))
        cosine = np.maximum((towards * geometric[at]).sum(1), 0)
        slack = tolerance / np.maximum(cosine, 0.2)  # a pixel spans more depth at grazing angles; 0.2 = 78 degrees
        agrees = (depth > 0) & (np.abs(depth - z) < slack)
        at, r, c, w = at[agrees], r[agrees], c[agrees], cosine[agrees] ** 4
        total[at] += w[:, None] * np.concatenate([view.normal[r, c], view.material[r, c]], -1)
        weight[at] += w
    seen = weight > 1e-4  # cosine 0.1: beyond 84 degrees a pixel says nothing
    if not seen.any():
        raise ValueError("no vertex is seen by any view")
    mean = total[seen] / weight[seen, None]
    normal = geometric.copy()
    length = np.linalg.norm(mean[:, :3], axis=1, keepdims=True)
    agrees = (length[:, 0] > 0.5) & ((mean[:, :3] * geometric[seen]).sum(1) > 0)
    normal[np.nonzero(seen)[0][agrees]] = mean[agrees, :3] / length[agrees]
    material = np.empty((len(mesh.vertices), 5))
    material[seen] = mean[:, 3:]
    if not seen.all():
        _, nearest = cKDTree(mesh.vertices[seen]).query(mesh.vertices[~seen])
        material[~seen] = mean[nearest, 3:]
    attributes = {"normal": normal.astype(np.float32), "material": material.astype(np.float32)}
    return Mesh(mesh.vertices, mesh.faces, attributes), float(seen.mean())


def vertex_table(mesh: Mesh) -> dict[str, NDArray]:
    """A mesh's vertex properties by name, [V] each: position, normal, material, and display colour in bytes."""
    from pipeline.formats.images import srgb_encode

    material = mesh.attributes["material"]
    values = np.concatenate([mesh.vertices.astype(np.float32), mesh.attributes["normal"], material], -1)
    colour = (srgb_encode(material[:, :3]) * 255 + 0.5).astype(np.uint8)
    table: dict[str, NDArray] = dict(zip(("x", "y", "z", "nx", "ny", "nz", *NAMES), values.T))
    return table | dict(zip(("red", "green", "blue"), colour.T))
