"""Outlines of relit views where the mesh and the G-buffer disagree on what is seen."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from stages.relight.outlines import Outlines


def test_where_the_meshs_normal_disagrees_inside_the_mask_the_darker_of_blend_and_mesh_is_taken():
    normal = np.array([[0.0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]])  # of the view's pixels
    surface: Any = SimpleNamespace(normal=np.tile([0.0, 0, 1], (4, 1)))  # of the mesh: a web across a hole
    mean = csr_matrix(np.eye(5, 4))  # the last pixel meets nothing
    rows, told = np.arange(5), np.array([True, True, True, False, True])
    outlines = Outlines(rows, surface, mean, np.ones(5, np.float32), np.zeros(5, bool)).doubting(normal, told)
    assert list(outlines.doubted) == [False, True, True, False, False]
    stokes = np.zeros((5, 3, 3), np.float32)
    stokes[:, 0] = np.array([1, 1, 3, 1, 1])[:, None]
    of_mesh = np.zeros((4, 3, 3), np.float32)
    of_mesh[:, 0] = 2
    got = outlines.replaced(stokes, of_mesh)[:, 0, 0]
    # The normals agree; the web mirrors a lamp; the mesh is darker; the splats tell nothing; no ray meets the mesh.
    assert list(got) == [2, 1, 2, 2, 1]
