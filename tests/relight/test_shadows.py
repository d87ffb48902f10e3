"""The shadows that a mesh throws on itself against brute force: every ray against every triangle, in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.formats.ply import write_ply
from pipeline.geometry.mesh import Mesh
from pipeline.geometry.occluder import tangent_frames
from pipeline.optics import fresnel
from pipeline.optics.sphere import hemisphere_rule
from pipeline.shading.prefilter_kernels import REFERENCE_IOR
from stages.mesh.attributes import vertex_table
from stages.relight.deferred import Lamp, ShadingModel, Surface
from stages.relight.mesh_shadows import SelfOcclusion
from synth.shape import vase

START = 1e-4  # of a shape of size 2: off the surface, far below its features


def first_hit_is_outside(origin, directions, corners) -> np.ndarray:
    """Whether each ray [R, 3] from `origin` meets the outer side of its first triangle [F, 3, 3] (Moeller-Trumbore)."""
    a = corners[:, 0]
    e1, e2 = corners[:, 1] - a, corners[:, 2] - a
    p = np.cross(directions[:, None], e2)
    det = (p * e1).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (p * (origin - a)).sum(-1) / det
        q = np.cross(origin - a, e1)
        v = directions @ q.T / det
        t = (q * e2).sum(-1) / det
        meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & np.isfinite(t)
    t = np.where(meets, t, np.inf)
    first = t.argmin(1)
    rows = np.arange(len(directions))
    return np.isfinite(t[rows, first]) & (det[rows, first] > 0)  # det = -(normal . direction)


def arriving(shape, chosen) -> np.ndarray:
    """Share of a white sky's light, by the way it passes into the surface, that reaches the chosen vertices."""
    local, weight = hemisphere_rule(6, 24)
    weight = weight * local[:, 2] * fresnel.transmittance(local[:, 2], np.asarray(REFERENCE_IOR))
    corners = shape.vertices[shape.faces]
    out = []
    for k in chosen:
        directions = local @ tangent_frames(shape.normals[k][None])[0]
        blocked = first_hit_is_outside(shape.vertices[k] + START * shape.normals[k], directions, corners)
        out.append(1 - (weight * blocked).sum() / weight.sum())
    return np.array(out)


@pytest.fixture(scope="module")
def bowl():
    """(a vase, some of its vertices, the light that reaches them)."""
    shape = vase(48, 36)
    chosen = np.arange(0, len(shape.vertices), 29)
    return shape, chosen, arriving(shape, chosen)


@pytest.mark.slow
@pytest.mark.parametrize("own_rays", [False, True])
def test_shadows_of_a_concave_shape_are_those_of_brute_force(bowl, tmp_path, own_rays):
    shape, chosen, want = bowl
    dark = want < 0.8
    assert dark.sum() >= 8  # else the shape is no test

    material = np.tile(np.array([0.7, 0.3, 0.1, 0.4, 1.5], np.float32), (len(shape.vertices), 1))
    whole = Mesh(shape.vertices, shape.faces, {"normal": shape.normals.astype(np.float32), "material": material})
    write_ply(tmp_path / "mesh.ply", vertex_table(whole), shape.faces)
    model = ShadingModel()
    occluder = SelfOcclusion(tmp_path / "mesh.ply", model)
    n = shape.normals[chosen]
    frames = tangent_frames(n)
    surface = Surface(shape.vertices[chosen], n, n, material[chosen], frames[:, 0], frames[:, 1])
    lamp = Lamp(np.ones((16, 32, 3), np.float32), 16, model)
    got = occluder.at(occluder.attach(surface, own_rays), occluder.under(lamp)).shadow
    error = got[:, 0].numpy() - want
    assert abs(error.mean()) < 0.005  # 0.0015 measured
    assert abs(error[dark].mean()) < 0.01  # 0.0016
    assert error.std() < 0.02  # 0.014
