"""Rays, distances, normals and axes: against what they are on a cube."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.axes import nearest_to_lines
from pipeline.geometry.normals import UPWARD, vertex_normals
from pipeline.geometry.polygons import triangulated
from pipeline.geometry.rays import RayMesh

CUBE = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij"), -1).reshape(-1, 3)
SQUARES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
FACES = triangulated(np.full(6, 4), SQUARES.ravel(), CUBE)


@pytest.fixture(scope="module")
def cube() -> RayMesh:
    return RayMesh(CUBE, FACES)


def test_a_ray_finds_place_triangle_and_outward_normal(cube: RayMesh) -> None:
    found = cube.cast(np.array([5.0, 0.2, 0.3]), np.array([[-1.0, 0, 0], [1.0, 0, 0]]))
    assert found.hit.tolist() == [True, False] and found.distance[0] == pytest.approx(4)
    corners = CUBE[FACES[found.triangle[0]]]
    assert found.weights[0] @ corners == pytest.approx([1, 0.2, 0.3], abs=1e-6)
    assert found.corner[0] == found.weights[0].argmax()
    assert found.normal[0] / np.linalg.norm(found.normal[0]) == pytest.approx([1, 0, 0])


def test_rays_of_an_image_keep_its_shape(cube: RayMesh) -> None:
    directions = np.broadcast_to([0.0, 0.0, -1.0], (4, 5, 3))
    assert cube.distance(np.array([0.1, 0.2, 3.0]), directions) == pytest.approx(np.full((4, 5), 2.0))
    assert cube.blocked(np.array([0.1, 0.2, -3.0]), directions).shape == (4, 5)


def test_crossings_inside_and_distances_of_a_closed_mesh(cube: RayMesh) -> None:
    points = np.array([[0.1, 0.2, 0.5], [0.1, 0.2, 1.5]])
    assert cube.inside(points).tolist() == [True, False]
    assert cube.signed_distance(points) == pytest.approx([0.5, -0.5])
    assert cube.crossings(points, np.array([0.0, 0.0, -1.0])).tolist() == [1, 2]
    near = cube.closest(points)
    assert near.position == pytest.approx(np.array([[0.1, 0.2, 1.0], [0.1, 0.2, 1.0]]), abs=1e-6)
    assert np.einsum("pk,pkc->pc", near.weights, CUBE[FACES[near.triangle]]) == pytest.approx(near.position, abs=1e-6)


def test_vertex_normals_point_outwards_and_unused_vertices_get_what_is_asked() -> None:
    vertices = np.concatenate([CUBE, [[9.0, 9, 9]]])
    normals = vertex_normals(vertices, FACES)
    assert ((normals[:8] * CUBE).sum(1) > 1).all() and np.linalg.norm(normals[:8], axis=1) == pytest.approx(1)
    assert normals[8].tolist() == [0, 0, 0] and vertex_normals(vertices, FACES, UPWARD)[8].tolist() == [0, 0, 1]


def test_lines_through_a_point_meet_there_and_parallel_ones_nowhere() -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(6, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    point = np.array([1.0, -2.0, 30.0])
    origins = point - directions * rng.uniform(1, 9, (6, 1))
    assert nearest_to_lines(origins, directions) == pytest.approx(point)
    assert nearest_to_lines(origins, np.tile(directions[:1], (6, 1))) is None
    assert nearest_to_lines(origins[:1], directions[:1]) is None
