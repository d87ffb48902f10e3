"""Fewer triangles, the same surface: how far it may move, that it stays whole, and that no speck looks inward."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.mesh import Mesh
from pipeline.geometry.rays import RayMesh
from pipeline.geometry.topology import topology
from stages.mesh.clean import unfolded
from stages.mesh.decimate import decimated


def ball(scale: float = 1.0, rings: int = 40) -> Mesh:
    """A closed sphere of many triangles."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rings + 1)[1:-1], np.arange(2 * rings) * np.pi / rings, indexing="ij")
    body = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    index, n = np.arange(len(body)).reshape(rings - 1, 2 * rings), 2 * rings
    a, b, c, d = (x.ravel() for x in (index[:-1], index[1:], np.roll(index[:-1], -1, 1), np.roll(index[1:], -1, 1)))
    top, bottom = np.full(n, len(body)), np.full(n, len(body) + 1)
    caps = [np.stack([top, index[0], np.roll(index[0], -1)], -1), np.stack([bottom, np.roll(index[-1], -1), index[-1]], -1)]
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1), *caps])
    return Mesh(scale * np.concatenate([body, [[0, 0, 1], [0, 0, -1.0]]]), faces.astype(np.int64))


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_triangles_go_as_far_as_the_tolerance_and_no_further(scale):
    mesh = ball(scale)
    coarse, fine = decimated(mesh, 0.01 * scale), decimated(mesh, 0.003 * scale)
    assert len(coarse.faces) < 0.5 * len(fine.faces) < 0.5 * len(mesh.faces)
    for kept, tolerance in ((coarse, 0.01), (fine, 0.003)):
        near = RayMesh(kept.vertices, kept.faces).closest(mesh.vertices).position
        assert np.quantile(np.linalg.norm(near - mesh.vertices, axis=1), 0.999) <= tolerance * scale
        found = topology(kept.vertices, kept.faces)
        assert (found.components, found.genus, found.inside_out) == (1, 0, 0)


def test_nothing_goes_where_nothing_may_move():
    mesh = ball(rings=8)
    assert len(decimated(mesh, 0.0).faces) == len(mesh.faces)


def test_specks_that_look_inward_are_unfolded():
    mesh = ball(rings=12)
    folded = mesh.vertices.copy()
    folded[60] = 2 * folded[61] - folded[60]  # past its neighbour
    folded[60] *= 0.98
    assert topology(folded, mesh.faces).inside_out > 0
    after = unfolded(Mesh(folded, mesh.faces))
    assert topology(after.vertices, after.faces).inside_out == 0
    untouched = np.ones(len(folded), bool)
    untouched[np.unique(mesh.faces[np.isin(mesh.faces, [60, 61]).any(1)])] = False
    assert np.array_equal(after.vertices[untouched], mesh.vertices[untouched])
