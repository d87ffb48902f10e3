"""Bright parts of an environment, and the shadows they throw: edges where brute force has them, in mirrored light too."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.geometry.occluder import Occluder
from pipeline.optics import fresnel, sphere
from pipeline.shading import Prefilter
from pipeline.shading.bright_parts import bright_parts
from pipeline.shading.cube import cube_directions
from pipeline.shading.light_tree_plain import Leaves, lobe_weights
from pipeline.shading.prefilter_kernels import REFERENCE_IOR
from pipeline.shading.sharp_shadows import Points, SharpShadows
from pipeline.shading.transfer import Transfer

SIZE = 64
LAMP = np.array([0.4, 0.9, 0.0]) / np.hypot(0.4, 0.9)


def lamp_and_sky() -> torch.Tensor:
    """A cube [6, SIZE, SIZE, 3]: a lamp of 8 degrees, twenty times as strong as the even sky."""
    lit = cube_directions(SIZE) @ LAMP > np.cos(np.radians(4))
    return torch.as_tensor(np.where(lit[..., None], [120.0, 100, 80], 0.1), dtype=torch.float32)


def roofed_floor() -> Occluder:
    """A coarse floor y = 0, half of it under a roof (x < 0, y = 0.5) that faces it."""
    grid = np.linspace(-1, 1, 7)
    x, z = (a.ravel() for a in np.meshgrid(grid, grid, indexing="ij"))
    vertices = np.concatenate([np.stack([x, 0 * x, z], -1), [[-2, 0.5, -2], [0, 0.5, -2], [0, 0.5, 2], [-2, 0.5, 2]]])
    i, j = (a.ravel() for a in np.meshgrid(np.arange(6), np.arange(6), indexing="ij"))
    a, b, c, d = 7 * i + j, 7 * i + j + 1, 7 * i + 7 + j + 1, 7 * i + 7 + j
    triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1), [[49, 50, 51], [49, 51, 52]]])
    normals = np.repeat([[0.0, 1, 0], [0, -1, 0]], [49, 4], axis=0)
    return Occluder(vertices, triangles, normals)


def test_bright_parts_hold_the_light_of_the_texels_that_they_stand_for():
    field = Prefilter(SIZE).apply(lamp_and_sky())
    parts = bright_parts(field.tree, 16)
    angles = np.tile(sphere.cube_solid_angles(16).ravel(), 6)
    coarse = field.pyramid[6 * (64**2 + 32**2) :][: 6 * 16**2].numpy()
    want = (coarse * angles[:, None])[parts.texels]
    got = np.zeros_like(want)
    np.add.at(got, parts.owner, parts.radiance * parts.solid_angle[:, None])
    assert got == pytest.approx(want, rel=1e-4)
    assert want.sum() > 0.9 * (coarse * angles[:, None])[coarse.sum(1) > 1].sum()
    assert (parts.direction @ LAMP > np.cos(np.radians(12))).all() and 16 < len(parts.owner) <= 128


def test_light_from_everywhere_has_no_bright_parts():
    field = Prefilter(32).apply(torch.ones(6, 32, 32, 3))
    assert len(bright_parts(field.tree, 16).owner) == 0
    dark = Prefilter(32).apply(torch.zeros(6, 32, 32, 3))
    assert len(bright_parts(dark.tree, 16).owner) == 0


@pytest.mark.slow
@pytest.mark.parametrize("own_rays", [False, True])
def test_a_lamps_shadow_has_its_edge_where_brute_force_has_it(own_rays):
    floor, radiance = roofed_floor(), lamp_and_sky()
    field = Prefilter(SIZE, "beckmann").apply(radiance)
    transfer = Transfer(floor, np.full((len(floor.vertices), 3), 0.5), resolution=16)
    light = transfer.light(radiance)
    position = np.stack([np.linspace(-0.6, 0.5, 45), np.zeros(45), np.full(45, 0.05)], -1)
    normal, view = np.tile([0.0, 1, 0], (45, 1)), np.tile(LAMP * [-1, 1, 1], (45, 1))
    roughness, ior = np.full(45, 0.4), np.full(45, 1.5)
    attached = transfer.attach(position, normal, view, roughness, lobe="beckmann", own_rays=own_rays)
    points = Points.of(position, normal, view, roughness, ior)
    got = SharpShadows(transfer, light, field).occlusion(points, attached, light)
    coarse = transfer.occlusion(attached, light)

    directions, angles = cube_directions(SIZE).reshape(-1, 3), np.tile(sphere.cube_solid_angles(SIZE).ravel(), 6)
    starts = np.repeat(position + floor.lift * normal, len(directions), 0)
    seen = ~floor.cast(starts, np.tile(directions, (45, 1))).blocked.reshape(45, -1)
    cosine = np.maximum(directions[:, 1], 0)
    bright = radiance.reshape(-1, 3).numpy()
    weight = (cosine * fresnel.transmittance(cosine, np.asarray(REFERENCE_IOR)) * angles)[:, None] * bright
    shadow = np.einsum("pk,kc->pc", seen, weight) / weight.sum(0)
    single = [torch.as_tensor(a[:1], dtype=torch.float32) for a in (normal, view)]
    each, where = torch.zeros(len(directions), dtype=torch.long), torch.as_tensor(directions, dtype=torch.float32)
    solid = torch.as_tensor(angles, dtype=torch.float32)
    leaves = Leaves(each, each, where, solid, torch.zeros_like(solid))
    lobe = lobe_weights(*single, torch.tensor([0.16]), torch.tensor([1.5]), leaves, "beckmann")[0].numpy()
    mirrored = (seen * lobe * bright.sum(1)).sum(1) / (lobe * bright.sum(1)).sum()

    assert shadow.min() < 0.1 and shadow.max() > 0.95 and (abs(shadow[:, 0] - 0.5) < 0.4).sum() >= 3
    assert np.abs(got.shadow.numpy() - shadow).max() < 0.06
    assert np.abs(coarse.shadow.numpy() - shadow).max() > 0.12
    assert np.abs(got.unblocked.numpy() - mirrored).max() < 0.1
    assert np.abs(coarse.unblocked.numpy() - mirrored).max() > 0.2
    assert (got.bounced == coarse.bounced).all() and (got.seen == coarse.seen).all()
