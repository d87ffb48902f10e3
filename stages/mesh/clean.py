"""From the extracted surface to a tidy mesh: pieces, holes, order."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.mesh import Mesh
from pipeline.geometry.topology import edges_of, inside_out

UNFOLDINGS = 20  # rounds; two or three do


def subdivided(mesh: Mesh) -> Mesh:
    """Every triangle cut into four at the middles of its edges: vertices twice as dense, for what is measured on them."""
    corners = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, of = np.unique(np.sort(corners, 1), axis=0, return_inverse=True)
    a, b, c = mesh.faces.T
    ab, bc, ca = (len(mesh.vertices) + of.reshape(-1, 3)).T
    faces = np.stack([np.stack(part, -1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))], 1).reshape(-1, 3)
    return Mesh(np.concatenate([mesh.vertices, mesh.vertices[edges].mean(1)]), faces)


def unfolded(mesh: Mesh) -> Mesh:
    """No triangle inside out: the corners of such specks move to the mean of their neighbours, until there are none."""
    vertices = mesh.vertices
    for _ in range(UNFOLDINGS):
        folded = inside_out(vertices, mesh.faces)
        if not folded.any():
            break
        corners = np.zeros(len(vertices), bool)
        corners[mesh.faces[folded]] = True
        i, j = edges_of(mesh.faces[corners[mesh.faces].any(1)])
        ends, others = np.concatenate([i, j]), np.concatenate([j, i])
        total = np.stack([np.bincount(ends, vertices[others, k], len(vertices)) for k in range(3)], -1)
        count = np.bincount(ends, minlength=len(vertices))[:, None]
        vertices = np.where(corners[:, None], total / np.maximum(count, 1), vertices)
    return Mesh(vertices, mesh.faces, mesh.attributes)


def boundary_loops(mesh: Mesh) -> list[NDArray[np.int64]]:
    """Closed chains of boundary edges, as vertex indices in the order of the hole's rim."""
    f = mesh.faces
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    key = edges[:, 0] * len(mesh.vertices) + edges[:, 1]
    twin = edges[:, 1] * len(mesh.vertices) + edges[:, 0]
    open_edges = edges[~np.isin(key, twin)]
    following: dict[int, list[int]] = {}
    for a, b in open_edges:
        following.setdefault(int(b), []).append(int(a))  # against the triangles' sense: the filling turns outward
    loops = []
    while following:
        start = next(iter(following))
        loop, at = [start], start
        while at in following:
            ahead = following[at].pop()
            if not following[at]:
                del following[at]
            at = ahead
            if at == start:
                break
            loop.append(at)
        if at == start and len(loop) > 2:
            loops.append(np.array(loop))
    return loops


def fill_holes(mesh: Mesh, rings: int = 12) -> tuple[Mesh, int]:
    """Close every hole by rings of triangles that shrink towards its centre; returns the mesh and the number closed.

    A flat rim gets a flat lid. The lids are guesses where nothing was seen: shadows and closedness need them.
    """
    vertices, faces, count = [mesh.vertices], [mesh.faces], len(mesh.vertices)
    loops = boundary_loops(mesh)
    for loop in loops:
        rim = mesh.vertices[loop]
        centre = rim.mean(0)
        n, steps = len(loop), 1 if len(loop) < 24 else rings
        inner = [centre + (rim - centre) * (1 - k / steps) for k in range(1, steps)]
        ids = [loop] + [count + k * n + np.arange(n) for k in range(steps - 1)]
        for outer_ring, inner_ring in itertools.pairwise(ids):
            a, b, c, d = outer_ring, np.roll(outer_ring, -1), inner_ring, np.roll(inner_ring, -1)
            faces += [np.stack([a, b, c], -1), np.stack([b, d, c], -1)]
        tip = count + (steps - 1) * n
        faces.append(np.stack([ids[-1], np.roll(ids[-1], -1), np.full(n, tip)], -1))
        vertices += [*inner, centre[None]]
        count = tip + 1
    return Mesh(np.concatenate(vertices), np.concatenate(faces)), len(loops)
