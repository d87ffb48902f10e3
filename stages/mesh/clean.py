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
    """No triangle inside out: the corners of such specks move to the mean of their neighbours, until there are none.

    After each round only the triangles about what moved are looked at again.
    """
    faces, folded = mesh.faces, np.flatnonzero(inside_out(mesh.vertices, mesh.faces))
    if not len(folded):
        return mesh
    about, vertices = _FacesAbout(faces, len(mesh.vertices)), mesh.vertices.copy()
    for _ in range(UNFOLDINGS):
        corners = np.unique(faces[folded])
        touched = about(corners)
        vertices[corners] = _means_of_neighbours(vertices, faces[touched], corners)
        doubtful = about(np.unique(faces[touched]))  # a normal of theirs has changed
        patch = about(np.unique(faces[doubtful]))
        used, local = np.unique(faces[patch], return_inverse=True)
        inward = patch[inside_out(vertices[used], local.reshape(-1, 3))]
        folded = np.union1d(np.setdiff1d(folded, doubtful), np.intersect1d(inward, doubtful))
        if not len(folded):
            break
    return Mesh(vertices, faces, mesh.attributes)


class _FacesAbout:
    """Which triangles have a corner among some vertices."""

    def __init__(self, faces: NDArray[np.int64], vertices: int) -> None:
        self._face = np.argsort(faces.ravel(), kind="stable") // 3
        self._first = np.concatenate([[0], np.cumsum(np.bincount(faces.ravel(), minlength=vertices))])

    def __call__(self, vertices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Their numbers [N], sorted."""
        return np.unique(np.concatenate([self._face[self._first[v] : self._first[v + 1]] for v in vertices]))


def _means_of_neighbours(vertices: NDArray, faces: NDArray[np.int64], corners: NDArray[np.int64]) -> NDArray[np.float64]:
    """The mean [C, 3] of the vertices that share an edge of some triangles with each corner [C], sorted."""
    i, j = edges_of(faces)
    ends, others = np.concatenate([i, j]), np.concatenate([j, i])
    place = np.minimum(np.searchsorted(corners, ends), len(corners) - 1)
    ours = corners[place] == ends
    place, others = place[ours], others[ours]
    total = np.stack([np.bincount(place, vertices[others, k], len(corners)) for k in range(3)], -1)
    return total / np.maximum(np.bincount(place, minlength=len(corners)), 1)[:, None]


def boundary_loops(mesh: Mesh) -> list[NDArray[np.int64]]:
    """Closed chains of boundary edges, as vertex indices in the order of the hole's rim."""
    open_edges = _edges_without_twin(mesh.faces)
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


def _edges_without_twin(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The triangles' edges [E, 2], in their sense, that no triangle has in the other sense."""
    start, end = faces.T.ravel(), np.roll(faces, -1, 1).T.ravel()
    along = start < end
    key = np.where(along, start, end) * (int(faces.max(initial=0)) + 1) + np.where(along, end, start)
    order = np.argsort(key)
    run = np.empty(len(key), np.int64)
    run[order] = np.cumsum(np.diff(key[order], prepend=-1) > 0) - 1
    there, back = (np.bincount(run[way], minlength=len(key)) for way in (along, ~along))
    alone = np.where(along, back[run], there[run]) == 0
    return np.stack([start[alone], end[alone]], -1)


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
