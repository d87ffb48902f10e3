"""How much of the light about it reaches each vertex past the rest of the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.occluder import Occluder, simplified
from pipeline.optics.sphere import sphere_rule

from ..clean import Mesh

Float = NDArray[np.float64]
RULE = 12  # 288 directions over the sphere: a share of light is then known to 3 %
PART = 20_000  # vertices whose rays are cast together


def occlusion(mesh: Mesh, normals: Float) -> NDArray[np.float32]:
    """Share [V] of an even sky's cosine-weighted light that reaches the vertices: 1 where nothing stands before them."""
    occluder = Occluder(*simplified(mesh.vertices, mesh.faces))
    directions, area = sphere_rule(RULE)
    out = np.ones(len(mesh.vertices), np.float32)
    for start in range(0, len(mesh.vertices), PART):
        own = slice(start, start + PART)
        cosine = np.maximum(normals[own] @ directions.T, 0.0) * area
        vertex, which = np.nonzero(cosine > 0)
        origins = (mesh.vertices[own] + occluder.lift * normals[own])[vertex]
        free = ~occluder.blocked(origins, directions[which])
        lit = np.bincount(vertex, cosine[vertex, which] * free, minlength=len(cosine))
        out[own] = lit / np.maximum(cosine.sum(1), 1e-9)
    return out
