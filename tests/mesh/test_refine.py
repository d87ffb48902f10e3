"""Positions that ripple and normals that do not: the mesh takes the best of both."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.mesh import Mesh
from stages.mesh.refine import following_normals


def rippled_plane(amplitude: float, period: int, size: int = 40) -> Mesh:
    """A plane whose heights ripple and whose normal attribute says that it is flat."""
    x, y = np.meshgrid(np.arange(size + 1.0), np.arange(size + 1.0))
    height = amplitude * np.sin(2 * np.pi * x / period)
    index = np.arange((size + 1) ** 2).reshape(size + 1, size + 1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)])
    up = np.tile(np.array([0, 0, 1], np.float32), (x.size, 1))
    return Mesh(np.stack([x.ravel(), y.ravel(), height.ravel()], -1), faces, {"normal": up})


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_ripple_goes_and_the_shape_stays_at_any_scale(scale):
    for period, low, high in ((4, 0.0, 0.15), (400, 0.8, 1.0)):  # in edges; `reach` is 4; 0.12 and 0.98 measured
        mesh = rippled_plane(0.3, period)
        before = np.ptp(mesh.vertices[:, 2])
        after = following_normals(Mesh(mesh.vertices * scale, mesh.faces, mesh.attributes), 4.0)
        assert low <= np.ptp(after.vertices[:, 2]) / scale / before <= high
        assert np.allclose(after.vertices[:, :2], mesh.vertices[:, :2] * scale)


def test_relief_that_the_normals_tell_appears():
    mesh = rippled_plane(0.0, 8)
    slope = 0.2 * 2 * np.pi / 8 * np.cos(2 * np.pi * mesh.vertices[:, 0] / 8)
    normal = np.stack([-slope, 0 * slope, 1 + 0 * slope], -1)
    mesh.attributes["normal"] = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    after = following_normals(mesh, 8.0)
    want = 0.2 * np.sin(2 * np.pi * mesh.vertices[:, 0] / 8)
    inner = np.abs(mesh.vertices[:, 0] - 20) < 15
    assert np.corrcoef(after.vertices[inner, 2], want[inner])[0, 1] > 0.95
    assert np.ptp(after.vertices[inner, 2]) == pytest.approx(0.4, rel=0.25)
