"""Textures: what the views show, where it lies, and what nobody saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.asset.ambient import sky_seen
from pipeline.asset.atlas import MOST_FACES, PADDING, parts_of, texels_of, unwrap
from pipeline.asset.bake import GUESSED
from pipeline.asset.photo_detail import CapturedLight, photo_detail
from pipeline.asset.tangents import in_tangent_frame, vertex_tangents
from pipeline.formats.gbuffer import SurfaceImage
from pipeline.geometry.rays import RayMesh


def on_ball(surface) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the texels under the vertices, and the vertices' places on the unit sphere."""
    height, width = surface.maps["albedo"].shape[:2]
    at = np.clip((surface.uv * (width, height)).astype(int), 0, (width - 1, height - 1))
    return at[:, ::-1], surface.position


@pytest.mark.slow
def test_the_texture_holds_what_the_views_show(baked, truth):
    at, position = on_ball(baked)
    rows, columns = at.T
    error = np.abs(baked.maps["albedo"][rows, columns] - truth(position)).max(1)
    assert np.quantile(error, 0.95) < 0.03  # 0.018 measured; a texel is 0.05 of the ball's radius
    assert np.allclose(baked.maps["roughness"][rows, columns], 0.3, atol=1e-3)
    assert np.allclose(baked.maps["specular"][rows, columns], 0.04, atol=1e-4)
    assert baked.guessed < 0.02


def test_normals_are_straight_up_where_mesh_and_views_agree(baked):
    inside = baked.maps["coverage"][..., 0] > 0
    assert np.quantile(baked.maps["normal"][inside][:, 2], 0.02) > 0.995


def test_one_wrong_view_changes_nothing(ball_views, bake_ball, baked, truth):
    damaged = ball_views[3].values.copy()
    damaged[..., 3:6] = 1 - damaged[..., 3:6]
    robust = bake_ball([*ball_views[:3], replace(ball_views[3], values=damaged), *ball_views[4:]])
    at, position = on_ball(robust)
    error = np.abs(robust.maps["albedo"][at[:, 0], at[:, 1]] - truth(position)).max(1)
    assert np.quantile(error, 0.9) < 0.06  # the mean of all would be 0.1 off


def test_what_no_view_sees_is_filled_and_flagged(ball_views, bake_ball):
    half = bake_ball([v for v in ball_views if v.camera.centre[1] > 0])
    coverage = half.maps["coverage"][..., 0]
    assert set(np.unique(coverage)) == {0, np.float32(GUESSED), 1}
    assert 0.05 < half.guessed < 0.5
    assert (half.maps["albedo"][coverage == np.float32(GUESSED)] > 0.1).all()


def test_texels_beside_charts_take_their_neighbours(baked):
    assert (baked.maps["albedo"].min(-1) > 0.1).all()  # the pattern is nowhere darker than 0.2


def test_the_largest_texture_is_kept_to(ball_views, bake_ball):
    assert max(bake_ball(ball_views[:4], largest=40).maps["albedo"].shape[:2]) <= 40


def test_the_atlas_keeps_charts_apart_at_any_scale():
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0), indexing="ij"), -1).reshape(-1, 2)
    index = np.arange(25).reshape(5, 5)
    a, b, c, d = (x.ravel() for x in (index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)])
    flat = np.concatenate([grid, 0 * grid[:, :1]], 1)
    two = np.concatenate([flat, flat + np.array([0, 0, 50.0])])
    sizes = set()
    for scale in (1e-4, 1e5):
        atlas = unwrap(scale * two, np.concatenate([faces, faces + 25]), 0.25 * scale, 1024)
        sizes.add((atlas.width, atlas.height))
        covered = np.full(atlas.width * atlas.height, -1)
        texels = texels_of(atlas)
        covered[texels.index] = texels.face >= len(faces)
        covered = covered.reshape(atlas.height, atlas.width)
        near = np.array([np.roll(covered, (i, j), (0, 1)) for i in range(-PADDING + 2, PADDING - 1) for j in range(2)])
        assert not ((covered == 0) & (near == 1).any(0)).any()
    assert len(sizes) == 1


def test_a_mesh_of_many_triangles_is_laid_out_in_parts_and_keeps_their_order():
    step = np.arange(65.0)
    x, y = np.meshgrid(step, step)
    vertices = np.stack([x.ravel(), y.ravel(), 3 * np.sin(x / 9).ravel()], -1)
    at = np.arange(65 * 65).reshape(65, 65)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)])
    assert len(faces) > MOST_FACES
    part = parts_of(vertices[faces].mean(1), MOST_FACES)
    assert np.bincount(part).max() <= MOST_FACES and np.bincount(part).min() >= MOST_FACES // 2 - 1
    atlas = unwrap(vertices, faces, 0.25, 512)
    assert np.array_equal(atlas.source[atlas.faces], faces)
    covered = np.zeros(len(faces), bool)
    covered[texels_of(atlas).face] = True
    assert covered.mean() > 0.9 and atlas.uv.min() >= 0 and atlas.uv.max() <= 1


def test_tangents_follow_u_and_make_a_right_handed_frame(baked):
    atlas = unwrap(baked.position, baked.faces, 0.05, 512)
    position = baked.position[atlas.source]
    tangent = vertex_tangents(position, position, atlas)
    assert np.allclose(np.linalg.norm(tangent[:, :3], axis=1), 1)
    assert np.abs((tangent[:, :3] * position).sum(1)).max() < 1e-6
    local = in_tangent_frame(position, position, tangent)
    assert np.allclose(local, [0, 0, 1], atol=1e-5)
    edge = position[atlas.faces[:, 1]] - position[atlas.faces[:, 0]]
    step = (atlas.uv[atlas.faces[:, 1]] - atlas.uv[atlas.faces[:, 0]]) * (atlas.width, -atlas.height)
    t = tangent[atlas.faces[:, 0]]
    b = np.cross(position[atlas.faces[:, 0]], t[:, :3]) * t[:, 3:]
    along = np.stack([(edge * t[:, :3]).sum(1), (edge * b).sum(1)], -1)
    unit = along / np.linalg.norm(along, axis=1, keepdims=True), step / np.linalg.norm(step, axis=1, keepdims=True)
    assert np.quantile((unit[0] * unit[1]).sum(1), 0.05) > 0.98


def test_a_corner_sees_less_sky_than_a_plain():
    square = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0], [0, -9, 0], [0, -9, 2], [0, 9, 2], [0, 9, 0.0]])
    mesh = RayMesh(square, np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    points = np.array([[0.05, 0, 0], [8.9, 0, 0]])
    seen = sky_seen(mesh, points, np.array([[0, 0, 1.0]] * 2), 1e-3)
    assert seen[0] == pytest.approx(0.5, abs=0.05)  # half of the sky is behind the wall
    assert seen[1] > 0.8


@pytest.mark.slow
def test_a_photograph_tells_the_texture_that_the_model_blurs(ball_views):
    view = ball_views[0]
    shown = view.weight > 0
    albedo = np.where(shown[..., None], np.full(3, 0.5), 0)
    material = np.concatenate([albedo, view.values[..., 6:8]], -1).astype(np.float32)
    surface = SurfaceImage(view.values[..., :3], material, view.weight, view.depth)
    light = CapturedLight(np.ones((8, 16, 3), np.float32), "y")
    body, mirror = light.parts(surface, view.camera)
    stripes = np.where(np.arange(view.depth.shape[1]) % 4 < 2, 1.2, 1 / 1.2)[:, None]
    detail, weight = photo_detail((body * stripes + mirror).astype(np.float32), surface, light, view.camera, 4.0)
    middle = (slice(16, 32), slice(16, 32))
    assert (
        np.corrcoef(detail[middle][..., 0].ravel(), np.broadcast_to(np.log(stripes[16:32, 0]), (16, 16)).ravel())[0, 1] > 0.97
    )
    assert np.abs(detail[middle]).max() == pytest.approx(np.log(1.2), rel=0.15)
    assert weight[middle].min() > 0.5
    assert not detail[~shown].any()
