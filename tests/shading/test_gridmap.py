"""PhyGaP's GridMap: where anchors stand, what they see, how they are blended, against the plain definitions."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.geometry.rays import RayMesh
from pipeline.optics.model_names import ANCHOR_WEIGHTS
from pipeline.shading import Prefilter, shade
from pipeline.shading.anchors import box_anchors, surface_anchors
from pipeline.shading.gridmap import GridMap, LocalLight, nearest_albedo, plain_blend, plain_weights

SMALL = 8  # texels along an anchor's cube
GREY = 0.4


def test_gridmap_has_52_anchors_on_the_enlarged_box_and_none_inside_its_bottom():
    points = box_anchors(np.asarray([[-1.0, 0.0, -2.0], [1.0, 3.0, 2.0]]))
    assert points.shape == (52, 3) and len(np.unique(points, axis=0)) == 52
    np.testing.assert_allclose(np.abs(points[:, 0]).max(), 1.1)
    on_bottom = points[np.isclose(points[:, 1], points[:, 1].min())]
    assert len(on_bottom) == 12


def test_52_anchors_stand_close_to_the_surface_outside_and_all_around(ball):
    points = surface_anchors(ball)
    assert points.shape == (52, 3)
    closest = RayMesh(ball.vertices, ball.triangles).closest(points).position
    distance = np.linalg.norm(points - closest, axis=1)
    assert distance.max() < 0.08 and (np.linalg.norm(points, axis=1) > 1).all()  # of a ball of diameter 2
    apart = np.linalg.norm(points[:, None] - points, axis=-1) + 9 * np.eye(52)
    assert apart.min() > 0.3  # 52 caps of radius 0.28 cover a unit sphere's area


@pytest.mark.slow
def test_the_papers_cubes_have_64_texels_and_half_of_a_boxs_rays_hit(ball):
    grid = GridMap(ball, np.full(ball.vertices.shape, GREY))
    light = grid.light(torch.ones(6, 16, 16, 3), Prefilter(16).apply(torch.ones(6, 16, 16, 3)))
    assert light.field.resolution == 64 and light.tables.shape[1:] == (3, 64) and not light.tables[..., 52:].any()
    # Anchors at the corners of the box stand 1.9 from the centre, those on its faces 1.1 and more: the ball fills
    # (1 - sqrt(1 - 1/d^2))/2 of what they see.
    distance = np.linalg.norm(grid.anchors, axis=1)
    share = ((1 - np.sqrt(1 - 1 / distance**2)) / 2).mean()
    assert len(grid._hit) / (52 * 6 * 64**2) == pytest.approx(share, rel=0.1)


@pytest.mark.parametrize("weights", ANCHOR_WEIGHTS)
def test_blending_equals_the_plain_definition(ball, points, weights):
    grid = GridMap(ball, np.full(ball.vertices.shape, GREY), resolution=SMALL, weights=weights)
    radiance = torch.rand(6, 16, 16, 3, generator=torch.Generator().manual_seed(0))
    local = grid.light(radiance, Prefilter(16).apply(radiance))
    at, directions = torch.as_tensor(ball.vertices[:60]), points(60)[0]
    weight = plain_weights(at, torch.as_tensor(grid.anchors, dtype=torch.float32), weights, grid.floor)
    tables = torch.as_tensor(local.tables[..., :52])
    got = torch.as_tensor(grid.received(at.numpy(), directions.numpy(), local))
    torch.testing.assert_close(got, plain_blend(tables, local.field.transmitted, weight, directions), rtol=1e-5, atol=1e-6)
    roughness, rows = np.full(60, 0.3, np.float32), np.arange(0, 60, 2)  # 0.3 is a node: one level alone
    got = torch.as_tensor(grid.mirrored(at.numpy(), directions.numpy(), roughness, rows, local))
    level = local.field.specular[local.field.roughnesses.index(0.3)]
    torch.testing.assert_close(got[::2], plain_blend(tables, level, weight, directions)[::2], rtol=1e-5, atol=1e-6)
    assert not got[1::2].any()


def test_the_slope_of_received_light_is_its_change_with_the_normal(ball, points):
    grid = GridMap(ball, np.full(ball.vertices.shape, GREY), resolution=16)
    radiance = torch.rand(6, 16, 16, 3, generator=torch.Generator().manual_seed(0))
    local = grid.light(radiance, Prefilter(16).apply(radiance))
    at, normal = ball.vertices[:200], points(200)[0].numpy()
    here, slope = grid.received_and_slope(at, normal, local)
    np.testing.assert_array_equal(here, grid.received(at, normal, local))
    assert np.abs(np.einsum("pk,pkc->pc", normal, slope)).max() < 1e-4  # none along it
    step = 0.05 * np.cross(normal, np.random.default_rng(5).normal(size=normal.shape)).astype(np.float32)
    there = grid.received(at, normal + step, local)
    off = there - here - np.einsum("pk,pkc->pc", step, slope)
    assert np.abs(off).mean() < 0.1 * np.abs(there - here).mean()


@pytest.mark.parametrize("weights", ANCHOR_WEIGHTS)
def test_gridmap_weights_favour_the_near_by_default_and_the_far_as_printed(ball, weights):
    grid = GridMap(ball, np.ones(ball.vertices.shape), resolution=4, weights=weights)
    radiance = torch.ones(6, 4, 4, 3)
    local = grid.light(radiance, Prefilter(4).apply(radiance))
    distance = np.linalg.norm(grid.anchors - ball.vertices[0], axis=1)
    shares = []
    for anchor in (distance.argmin(), distance.argmax()):  # only it shines
        tables = np.zeros_like(local.tables)
        tables[:, :, anchor] = 1
        shares.append(grid.received(ball.vertices[:1], ball.vertices[:1], LocalLight(tables, local.field))[0, 0])
    assert (shares[0] > shares[1]) == (weights == "inverse-square")
    everywhere = np.zeros_like(local.tables)
    everywhere[..., :52] = 1
    total = grid.received(ball.vertices[:1], ball.vertices[:1], LocalLight(everywhere, local.field))
    np.testing.assert_allclose(total, 1, atol=1e-5)


def test_gridmap_refuses_weights_that_it_does_not_know(ball):
    with pytest.raises(ValueError, match="cubic"):
        GridMap(ball, np.ones(ball.vertices.shape), weights="cubic")


@pytest.mark.parametrize(("fresnel", "white"), [("exact", 1 / 0.9082220**2), ("schlick", 1.0)])
def test_gridmap_returns_the_environment_where_the_object_shines_like_it(ball, points, fresnel, white):
    # Under a white sky an albedo of 1/A0^2 makes the object as bright as the sky; one of 1 by Eq. 20 without its Fresnel term.
    grid = GridMap(ball, np.full(ball.vertices.shape, white), resolution=SMALL, fresnel=fresnel)
    radiance = torch.ones(6, 4, 4, 3)  # coarser than the anchors' cubes
    field = Prefilter(4).apply(radiance)
    at = ball.vertices[:40]
    arguments = points(40)
    arguments[0] = torch.as_tensor(at)
    roughness = arguments[3].clamp(0.1, 1).numpy()
    occlusion = grid.occlusion(at, at, arguments[1].numpy(), roughness, grid.light(radiance, field))
    got, want = (shade(*arguments, field, occlusion=o, fresnel=fresnel).stokes for o in (occlusion, None))
    torch.testing.assert_close(got, want, rtol=2e-3, atol=1e-4)


def test_albedo_of_a_place_is_the_mean_of_its_nearest_neighbours():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [9, 9, 9]])
    albedo = np.array([[0.1] * 3, [0.2] * 3, [0.3] * 3, [0.4] * 3, [1.0] * 3])
    found = nearest_albedo(points, albedo, np.array([[0.1, 0.1, 0.1]]))
    np.testing.assert_allclose(found, 0.25, rtol=1e-6)
    assert nearest_albedo(points[:1], albedo[:1], points).shape == (5, 3)  # fewer than it asks for
