"""Starting from sparse points: outliers go, normals face outwards, hollows are cut, and it works without any masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.geometry.cameras import Camera
from pipeline.geometry.silhouette_hull import Silhouette
from stages.calib.poses.write import write_points
from stages.train.initialise.points import PointSurface, orient, read_points
from stages.train.initialise.silhouettes import MARGIN, outline
from stages.train.initialise.start import start_surface
from stages.train.parameters import TrainParameters
from stages.train.setup import prepare_training

from .conftest import AXES, look_at, moved

DIMPLE = np.array([0.9, 0.75, 0.0])  # centre of a ball of radius 0.6 cut out of the unit ball


def cameras(count=24, size=64, scale=1.0):
    out = []
    for k in range(count):
        direction = np.array([np.cos(2.4 * k), -0.6 + 1.6 * k / count, np.sin(2.4 * k)])
        out.append(Camera(size, size, 1.7 * size, 1.7 * size, size / 2, size / 2, look_at(direction, 4.5 * scale)))
    return out


def ball_interval(camera, middle, radius):
    """Where every pixel's ray enters and leaves a ball, and whether it does."""
    rays, centre = camera.rays(), camera.centre
    b = (rays * (centre - middle)).sum(-1)
    half = np.sqrt(np.maximum(b * b - ((centre - middle) ** 2).sum() + radius**2, 0))
    return -b - half, -b + half, half > 0


def ball_masks(whole=False):
    """Silhouettes of the dimpled ball: they show the dimple's rim, never its floor. `whole`: no masks at all."""
    out = []
    for camera in cameras():
        (near, far, hit), (open_, close, dug) = ball_interval(camera, np.zeros(3), 1.0), ball_interval(camera, DIMPLE, 0.6)
        mask = hit & ~(dug & (open_ <= near) & (close >= far))
        out.append(Silhouette(camera, np.ones(mask.shape, np.float32) if whole else mask.astype(np.float32)))
    return out


def on_ball(count, rng):
    p = rng.normal(size=(count, 3))
    return p / np.linalg.norm(p, axis=-1, keepdims=True)


def dimpled(points):
    """Signed distance (a bound of it, exact in sign), positive inside the unit ball without the dimple."""
    return np.minimum(1 - np.linalg.norm(points, axis=-1), np.linalg.norm(points - DIMPLE, axis=-1) - 0.6)


def dimple_cloud(count=2500, noise=0.004, outliers=0.1):
    """Noisy points of the dimpled ball, and as many outliers about it as the share says."""
    rng = np.random.default_rng(3)
    outer, inner = on_ball(count, rng), DIMPLE + 0.6 * on_ball(count // 2, rng)
    outer = outer[np.linalg.norm(outer - DIMPLE, axis=-1) > 0.6]
    inner = inner[np.linalg.norm(inner, axis=-1) < 1]
    points = np.concatenate([outer, inner])
    points = points + noise * rng.normal(size=points.shape)
    return np.concatenate([points, rng.uniform(-1.2, 1.2, (int(outliers * len(points)), 3))])


def test_outliers_go_and_normals_face_outwards():
    cloud = orient(dimple_cloud(), np.array([c.centre for c in cameras()]))
    assert (np.abs(dimpled(cloud.points)) > 0.04).mean() < 0.01
    assert len(cloud.points) > 2300
    step = 0.1 * cloud.normals
    outward = (dimpled(cloud.points + step) < 0) & (dimpled(cloud.points - step) > 0)
    assert outward.mean() > 0.97


@pytest.mark.slow
def test_a_hollow_that_no_silhouette_shows_is_cut_and_the_rest_stays():
    masks, points = ball_masks(), dimple_cloud(3500)
    hull = start_surface(masks, points, "hull", True, 56, 0.0)
    both = start_surface(masks, points, "auto", True, 56, 0.0)
    assert both.points and not hull.points
    spared = np.linalg.norm(both.mesh.vertices - DIMPLE, axis=-1) > 0.75
    assert np.abs(np.linalg.norm(both.mesh.vertices[spared], axis=-1) - 1).mean() < 0.03
    floor = np.linalg.norm(both.mesh.vertices, axis=-1) < 0.75
    assert floor.sum() > 50 and np.abs(dimpled(both.mesh.vertices[floor])).mean() < 0.02
    assert np.linalg.norm(hull.mesh.vertices, axis=-1).min() > 0.8


@pytest.mark.slow
def test_a_part_that_points_would_cut_but_silhouettes_need_stays():
    masks, points = ball_masks(), dimple_cloud(3500)
    top = points[:, 1] > 0.7
    points[top, 1] = 1.4 - points[top, 1]  # folded down: a wrong cloud that lies within every silhouette
    both = start_surface(masks, points, "points", True, 48, 0.0)
    for silhouette in masks[::5]:
        bare = (silhouette.mask > 0.5) & (outline(both.mesh, silhouette.camera) == 0)
        assert bare.sum() < 0.01 * silhouette.mask.sum()


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_units_do_not_matter(scale):
    shift = scale * np.array([30.0, -20.0, 10.0])
    here = PointSurface(orient(dimple_cloud(), np.array([c.centre for c in cameras()])), fades=True)
    centres = np.array([c.centre for c in cameras()]) * scale + shift
    there = PointSurface(orient(dimple_cloud() * scale + shift, centres), fades=True)
    grid = np.random.default_rng(0).uniform(-1.1, 1.1, (500, 3))
    assert np.allclose(there.signed_distance(grid * scale + shift) / scale, here.signed_distance(grid), atol=1e-3)


@pytest.mark.slow
def test_without_masks_the_points_alone_are_the_object():
    begun = start_surface(ball_masks(whole=True), dimple_cloud(), "auto", False, 48, 0.0)
    assert begun.points and abs(begun.half - 1) < 0.05
    off = np.abs(dimpled(begun.mesh.vertices))
    assert np.percentile(off, 90) < 0.04
    for silhouette in ball_masks()[::6]:
        mask, truth = outline(begun.mesh, silhouette.camera), silhouette.mask > 0.5
        assert truth[mask == 1].mean() > 0.99 and (~truth[mask == 0]).mean() > 0.99
        assert ((mask > 0) & (mask < 1)).sum() < 3 * MARGIN * truth.sum() ** 0.5 * 4


def test_few_points_leave_the_hull_alone_and_say_why():
    masks, points = ball_masks(), dimple_cloud()[::20]
    begun = start_surface(masks, points, "auto", True, 40, 0.0)
    assert not begun.points and "needed" in begun.reason
    sparse = start_surface(masks, dimple_cloud()[::6], "auto", True, 40, 0.0)
    assert not sparse.points and "apart" in sparse.reason
    with pytest.raises(UserError, match="triangulate"):
        start_surface(masks, points, "points", True, 40, 0.0)


def test_points_of_the_poses_stage_are_read(tmp_path):
    points = dimple_cloud()[:50]
    write_points(tmp_path / "points.ply", points, np.zeros((50, 3), np.uint8))
    assert np.allclose(read_points(tmp_path / "points.ply"), points, atol=1e-6)
    assert read_points(tmp_path / "none.ply").shape == (0, 3)


@pytest.mark.slow
def test_training_without_masks_starts_from_points_or_from_what_all_cameras_see(make_sources):
    sources = [replace(s, mask=np.ones_like(s.mask)) for s in moved(make_sources(40, 16), 10.0, np.eye(3), np.full(3, 5.0))]
    parameters = TrainParameters(max_splats=1200, hull_resolution=32, environment_resolution=8)
    cloud = 10 * AXES * on_ball(1500, np.random.default_rng(0)) + 5
    start = prepare_training(sources, "stokes", {}, "y", parameters, "cpu", cloud)
    assert start.facts.points and not start.facts.masked and start.black_background
    assert abs(start.frame.scale - 10) < 0.5
    inside = np.concatenate([v.alpha_target.numpy().ravel() for v in start.pyramids[0]])
    assert 0.1 < (inside > 0.9).mean() < 0.5
    start = prepare_training(sources, "stokes", {}, "y", parameters, "cpu")
    assert not start.facts.points and start.frame.scale > 11
