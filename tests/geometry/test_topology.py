"""Pieces, handles, holes and specks of meshes whose shape is known."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.topology import edges_of, topology


def torus(around: int = 12, across: int = 8, centre: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A closed ring, outward."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = 2 * np.pi * u / around, 2 * np.pi * v / across
    radius = 2 + 0.5 * np.cos(b)
    vertices = np.stack([radius * np.cos(a) + centre, radius * np.sin(a), 0.5 * np.sin(b)], -1).reshape(-1, 3)

    def at(i, j):
        return ((u + i) % around * across + (v + j) % across).ravel()

    return vertices, np.concatenate(
        [np.stack([at(0, 0), at(1, 0), at(1, 1)], -1), np.stack([at(0, 0), at(1, 1), at(0, 1)], -1)]
    )


def test_a_ring_has_one_handle_and_two_rings_are_two_pieces():
    vertices, faces = torus()
    found = topology(vertices, faces)
    assert (found.components, found.genus, found.open_edges, found.crowded_edges, found.inside_out) == (1, 1, 0, 0, 0)
    other, _ = torus(centre=10.0)
    both = topology(np.concatenate([vertices, other]), np.concatenate([faces, faces + len(vertices)]))
    assert (both.components, both.genus) == (2, 2)


def test_a_hole_leaves_no_genus_and_its_edges_are_counted():
    vertices, faces = torus()
    found = topology(vertices, faces[1:])
    assert found.genus is None
    assert found.open_edges == 3


def test_a_turned_over_triangle_is_inside_out():
    vertices, faces = torus()
    faces = faces.copy()
    faces[5] = faces[5][::-1]
    assert topology(vertices, faces).inside_out == 1


def test_every_edge_is_listed_once():
    _, faces = torus()
    first, second = edges_of(faces)
    assert len(first) == 3 * len(faces) / 2
    assert (first < second).all()
