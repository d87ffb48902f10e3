"""How a surface hangs together: handles and pieces, triangles that cross others, area that looks inward."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.normals import cross_products
from pipeline.geometry.rays import RayMesh
from pipeline.geometry.topology import Topology, inside_out, topology

END = 1e-5  # share of an edge at its ends where a hit is the triangle that the edge belongs to
TILTS = 0.3 * np.array([[0.62, -0.55, 0.56], [-0.71, 0.17, 0.68], [0.23, 0.91, -0.34]])
"""Off the normal, of a triangle's three rays: the majority counts, for a ray through an edge counts twice or not at all."""
LIFT = 1e-4  # of the longest side: how far before a triangle rays begin


def quality(vertices: NDArray, faces: NDArray) -> dict[str, float | None]:
    """genus (None where the surface is open or branches), components, self_intersecting_pct of the triangles and
    inside_out_pct of the area, of vertices [V, 3] and triangles [F, 3]."""
    vertices, faces = welded(vertices, faces)
    if not len(faces):
        return {"genus": None, "components": 0}
    found = topology(vertices, faces)
    area = np.linalg.norm(cross_products(vertices, faces), axis=1)
    inward = looking_inward(vertices, faces, found)
    return {
        "genus": found.genus,
        "components": found.components,
        "self_intersecting_pct": float(100 * crossing(vertices, faces).mean()),
        "inside_out_pct": float(100 * area[inward].sum() / max(area.sum(), 1e-300)),
    }


def welded(vertices: NDArray, faces: NDArray) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices at one place as one, in units of the longest side about the middle; triangles that thereby vanish are gone."""
    low, high = vertices.min(0), vertices.max(0)
    places, where = np.unique(np.asarray(vertices, np.float64), axis=0, return_inverse=True)
    joined = where.reshape(-1)[np.asarray(faces, np.int64)]
    whole = (joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])
    return (places - (low + high) / 2) / max(float((high - low).max()), 1e-300), joined[whole]


def crossing(vertices: NDArray, faces: NDArray) -> NDArray[np.bool_]:
    """Which triangles [F] cross another that shares no corner with them: an edge of one runs through the other."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))  # half edges, those of one edge side by side
    ends, owner = ends[order], order % len(faces)
    begins = np.flatnonzero(np.r_[True, (ends[1:] != ends[:-1]).any(1)])
    count = np.diff(np.r_[begins, len(ends)])
    start, towards = vertices[ends[begins, 0]], vertices[ends[begins, 1]]
    edge, hit, along = RayMesh(vertices, faces).every_hit(start, towards - start)
    within = (along > END) & (along < 1 - END)
    edge, hit = edge[within], hit[within]
    out = np.zeros(len(faces), bool)
    for k in range(int(count.max(initial=0))):  # every triangle of an edge, two for most
        there = k < count[edge]
        mine, other = owner[begins[edge[there]] + k], hit[there]
        apart = ~(faces[mine][:, :, None] == faces[other][:, None, :]).any((1, 2))
        out[mine[apart]] = out[other[apart]] = True
    return out


def looking_inward(vertices: NDArray, faces: NDArray, found: Topology) -> NDArray[np.bool_]:
    """Which triangles [F] show their back outside: on a closed surface a ray from the front of such a one leaves the inside and
    crosses the surface an odd number of times; on an open one, those against the normals of all their corners."""
    if found.genus is None:
        return inside_out(vertices, faces)
    across = cross_products(vertices, faces)
    normal = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    start, surface = vertices[faces].mean(1) + LIFT * normal, RayMesh(vertices, faces)
    odd = [surface.crossings(start, normal + tilt) % 2 == 1 for tilt in TILTS]
    return np.asarray(sum(odd, np.zeros(len(faces), int)) > len(TILTS) // 2)
