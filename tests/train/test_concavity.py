"""Concavities: hollows without a silhouette are found by what the views agree on; what they agree on stays where it is."""

from __future__ import annotations

from copy import deepcopy
from typing import Literal

import numpy as np
import pytest
import torch

from pipeline.geometry.cameras import Camera
from pipeline.geometry.normals import vertex_normals
from pipeline.shading import Prefilter, shade
from stages.train import checkpoint, upkeep
from stages.train.concavity.depths import sample_depths
from stages.train.concavity.explanation import shading_tables, sphere_directions, unexplained
from stages.train.concavity.hollow import DepthField, hollowed
from stages.train.concavity.refit import refit
from stages.train.concavity.samples import Observations
from stages.train.concavity.search import FEWEST, certain, trial_depths, without_doubtful
from stages.train.initialise.hull import HullMesh
from stages.train.parameters import TrainParameters
from stages.train.setup import prepare_training
from stages.train.splats.gaussians import SplatModel, Splats
from stages.train.splats.optimiser import StepRule, SurfaceAdam
from stages.train.trainer import Trainer
from stages.train.upkeep import CONCAVITIES_AT
from stages.train.views.source_views import SourceView

from .conftest import ALBEDO, IOR, ROUGHNESS, ball_interval, look_at, plastic_image, sky

DENT_AT, DENT_RADIUS = np.array([0.0, 0.35, 1.25]), 0.75  # a ball taken out of the unit ball


def ball(count: int = 4000) -> HullMesh:
    """The unit ball as a mesh."""
    import open3d as o3d

    mesh = o3d.geometry.TriangleMesh.create_sphere(1.0, int(np.sqrt(count / 4)))
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    return HullMesh(vertices, triangles, vertex_normals(vertices, triangles))


def grid(side: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Points of a plane 0.05 apart, and their normals."""
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    points = np.stack([x.ravel() * 0.05, y.ravel() * 0.05, np.zeros(side * side)], -1)
    return points, np.tile([0.0, 0.0, 1.0], (len(points), 1))


def valleys(depths: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Residuals [L, P] that are least, 0.004, at the true depth, with noise."""
    away = np.abs(depths[:, None] - truth[None])
    return (0.004 + 0.15 * away) * np.exp(0.2 * rng.standard_normal(away.shape))


def test_neighbouring_samples_settle_on_the_depth_that_explains_them():
    points, normals = grid()
    truth = np.where(np.hypot(*(points[:, :2] - 0.6).T) < 0.3, 0.08, 0.0)
    depths = trial_depths()
    residual = valleys(depths, truth, np.random.default_rng(0))
    found = sample_depths(points, normals, depths, residual, np.full(residual.shape, 10))
    inner = np.hypot(*(points[:, :2] - 0.6).T)
    assert np.abs(found[inner < 0.2] - 0.08).max() < 0.02
    assert found[inner > 0.4].max() < 0.01


def test_samples_that_no_view_sees_follow_their_neighbours():
    points, normals = grid()
    depths = trial_depths()
    residual = valleys(depths, np.full(len(points), 0.08), np.random.default_rng(1))
    views = np.full(residual.shape, 10)
    blind = np.hypot(*(points[:, :2] - 0.6).T) < 0.15
    views[:, blind] = 0
    residual[:, blind] = np.inf
    found = sample_depths(points, normals, depths, residual, views)
    assert np.abs(found[blind] - 0.08).max() < 0.02


def test_a_surface_that_nothing_speaks_against_stays():
    points, normals = grid()
    depths = trial_depths()
    residual = np.full((len(depths), len(points)), 0.01) * np.exp(
        0.3 * np.random.default_rng(2).standard_normal((len(depths), len(points)))
    )
    assert sample_depths(points, normals, depths, residual, np.full(residual.shape, 10)).max() < 0.03


def test_shallow_depths_count_only_at_the_rim_of_a_certain_concavity():
    points, _ = grid()
    depths = np.zeros(len(points))
    depths[points[:, 0] < 0.12] = 0.06
    sure = points[:, 0] < 0.12
    depths[(points[:, 0] > 0.12) & (points[:, 0] < 0.28)] = 0.02  # its rim
    depths[points[:, 0] > 1.0] = 0.02  # doubtful
    kept = without_doubtful(points, depths, sure, np.full(len(points), 0.05))
    assert (kept[points[:, 0] < 0.28] == depths[points[:, 0] < 0.28]).all()
    assert (kept[points[:, 0] > 1.0] == 0).all()
    few = np.arange(len(points)) < FEWEST - 1  # too few to be more than chance
    assert (without_doubtful(points, np.full(len(points), 0.05), few, np.full(len(points), 0.05)) == 0).all()


def test_a_depth_is_certain_where_it_is_deep_and_explains_more_and_its_neighbours_agree():
    points, _ = grid()
    depths = trial_depths()
    middle = np.hypot(*(points[:, :2] - 0.6).T) < 0.3
    views = np.full((len(depths), len(points)), 10)

    def sure(there: float, where: np.ndarray = middle, deep: float = depths[4]) -> np.ndarray:
        residual = np.full(views.shape, 0.002)
        residual[:, middle] = 0.03
        residual[4, middle] = there
        return certain(points, np.where(where, deep, 0.0), depths, residual, views)

    assert sure(0.003)[middle].mean() > 0.9
    assert not sure(0.003)[~middle].any()
    assert not sure(0.025).any()  # hardly a better explanation
    assert not sure(0.003, deep=depths[1]).any()  # no deeper than reflections in the object fake
    assert not sure(0.003, where=middle & (np.arange(len(points)) % 5 == 0)).any()  # here and there
    views[4] = 2
    assert not sure(0.003).any()  # two views agree on anything


@pytest.mark.slow
def test_a_hollowed_ball_lacks_what_the_field_took_and_nothing_else():
    mesh = ball()
    samples = sphere_directions(4000).astype(float)
    cap = samples[:, 2] > 0.8
    hollow = hollowed(mesh, DepthField(samples, np.where(cap, 0.2, 0.0)), 0.09)
    assert hollow is not None
    radius = np.linalg.norm(hollow.vertices, axis=-1)
    direction = hollow.vertices / radius[:, None]
    assert np.abs(radius[direction[:, 2] < 0.7] - 1).max() < 0.02
    assert np.abs(radius[direction[:, 2] > 0.92] - 0.8).max() < 0.03


def test_nothing_is_left_of_a_ball_taken_back_by_its_radius():
    samples = sphere_directions(500).astype(float)
    assert hollowed(ball(1000), DepthField(samples, np.full(500, 1.2)), 0.19) is None


@pytest.mark.slow
def test_splats_on_untouched_ground_survive_a_refit_bit_for_bit():
    from stages.train.initialise.sampling import sample_evenly

    mesh = ball()
    rng = np.random.default_rng(0)
    model = SplatModel.from_samples(sample_evenly(mesh, 1500, rng), 0.4, 0.3, 1.5, "cpu")
    before = {name: t.detach().clone() for name, t in model.tensors.items()}
    adam = SurfaceAdam({"position": StepRule(1e-3)})
    model["position"].grad = torch.ones_like(model["position"])
    adam.step(model.tensors, {"": 1.0}, None)
    moved = model["position"].detach().clone()
    samples = sphere_directions(4000).astype(float)
    field = DepthField(samples, np.where(samples[:, 2] > 0.8, 0.2, 0.0))
    hollow = hollowed(mesh, field, 0.09)
    assert hollow is not None
    new = refit(model, adam, field, hollow, spacing=0.09, most=1600, seed=0)
    assert new is not None
    kept = len(model) - new
    assert new > 20 and len(model) <= 1600
    far = before["position"][:, 2] < 0.7
    rows = {tuple(row) for row in model["position"][:kept].tolist()}
    assert all(tuple(row) in rows for row in moved[far].tolist())
    assert torch.equal(model["anchor"], model["position"])
    radius = model["position"][kept:].norm(dim=-1)
    assert float(radius.detach().min()) < 0.83
    assert adam.first["position"].shape == model["position"].shape
    assert not adam.first["position"][kept:].any()


def observations(normals: np.ndarray, towards: np.ndarray, light) -> Observations:
    """What views along `towards` [V, 3] see of points whose normal may differ from view to view [P, V, 3]."""
    count, views = normals.shape[:2]
    v = np.broadcast_to(towards, (count, views, 3)).reshape(-1, 3).astype(np.float32)
    n = normals.reshape(-1, 3).astype(np.float32)
    x = np.cross(v, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y = np.cross(v, x)
    t = [torch.as_tensor(a, dtype=torch.float32) for a in (n, v, x, y)]
    many = len(n)
    albedo = torch.tensor(ALBEDO).expand(many, 3)
    stokes = shade(t[0], t[1], albedo, torch.full((many,), ROUGHNESS), torch.full((many,), IOR), t[2], t[3], light).stokes
    values = stokes.numpy().reshape(count, views, 9)
    slope = np.full((count, views, 3), 1.0, np.float32)
    own = np.zeros((count, views, 10), np.float32)
    own[..., :3], own[..., 9] = 1, 1
    shaped = [a.reshape(count, views, 3).astype(np.float32) for a in (v, x, y)]
    return Observations(np.full(count, views), values, slope, *shaped, np.zeros((count, views, 2), np.float32), own)


@pytest.mark.slow
def test_one_normal_explains_one_surface_and_not_two():
    light = Prefilter(16, "beckmann").apply(sky())
    normal = torch.tensor([[0.0, 0.0, 1.0]])
    one = torch.ones(1)
    splats = Splats(
        normal, normal, torch.zeros(1, 4), torch.ones(1, 2), one, torch.tensor([ALBEDO]), ROUGHNESS * one, IOR * one
    )
    tables = shading_tables(splats, light, "exact")
    angles = np.linspace(-0.9, 0.9, 9)
    towards = np.stack([np.sin(angles), 0.4 * np.cos(3 * angles), np.cos(angles)], -1)
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    rng = np.random.default_rng(0)
    tilt = rng.normal(0, 0.3, (40, 3)) + np.array([0, 0, 1])
    tilt /= np.linalg.norm(tilt, axis=-1, keepdims=True)
    same = np.repeat(tilt[:, None], 9, 1)
    # half the views look past the point at something else, turned by 40 degrees
    other = np.cross(same, [0.0, 1.0, 0.0])
    mixed = np.where((np.arange(9) < 5)[None, :, None], same, 0.77 * same + 0.64 * other)
    mixed /= np.linalg.norm(mixed, axis=-1, keepdims=True)
    albedo = np.tile(ALBEDO, (40, 1))
    alike = unexplained(observations(same, towards, light), albedo, tables)
    torn = unexplained(observations(mixed, towards, light), albedo, tables)
    assert np.median(alike) < 0.003
    assert np.median(torn) > 5 * np.median(alike)


def dented_view(camera: Camera, light) -> tuple[np.ndarray, np.ndarray]:
    """Stokes [H, W, 3, 3] and mask of the dented ball, by exact intersection: the dent's own shadow is left out."""
    rays, centre = camera.rays().reshape(-1, 3), camera.centre
    (near, far), (open_, close) = ball_interval(camera, np.zeros(3), 1.0), ball_interval(camera, DENT_AT, DENT_RADIUS)
    through = (open_ < near) & (near < close)  # the ray meets the ball where the dent is: go on to the dent's far side
    t = np.where(through, close, near)
    hit = np.isfinite(near) & (t < far)
    points = centre + rays * np.where(hit, t, 0.0)[:, None]
    normal = np.where(through[:, None], (DENT_AT - points) / DENT_RADIUS, points)
    shape = (camera.height, camera.width)
    return plastic_image(camera, hit, normal, light), hit.reshape(shape)


def dented_sources(size: int = 64, count: int = 24) -> list[SourceView]:
    """The dented ball from around."""
    light = Prefilter(16, "beckmann").apply(sky())
    sources = []
    for k in range(count):
        angle, height = 2.4 * k, -0.4 + 1.5 * k / count
        direction = np.array([np.cos(angle), height, np.sin(angle)])
        camera = Camera(size, size, 1.7 * size, 1.7 * size, size / 2, size / 2, look_at(direction, 4.5))
        stokes, mask = dented_view(camera.resized(2 * size, 2 * size), light)
        stokes, cover = (a.reshape(size, 2, size, 2, *a.shape[2:]).mean((1, 3)) for a in (stokes, mask))
        full = (cover > 0.99).astype(np.float32)
        split = "test" if k % 8 == 0 else "train"
        sources.append(SourceView(f"{k:03d}", split, camera, stokes.astype(np.float32), full, np.ones(full.shape, bool)))
    return sources


def dent_trainer(
    sources: list[SourceView], concavities: Literal["on", "off"], indirect: Literal["traced", "none"] = "none"
) -> Trainer:
    """A small training of it, not begun."""
    torch.set_num_threads(1)
    parameters = TrainParameters(
        iterations=800,
        max_splats=2500,
        hull_resolution=48,
        environment_resolution=16,
        indirect=indirect,
        concavities=concavities,
    )
    start = prepare_training(sources, "stokes", {}, "y", parameters, "cpu")
    return Trainer(start.scene, start.pyramids, "stokes", start.frame, parameters, "cpu")


@pytest.mark.slow
def test_training_finds_a_dent_that_no_silhouette_shows():
    sources = dented_sources()
    searching, not_searching = (dent_trainer(sources, concavities) for concavities in ("on", "off"))
    for _ in range(CONCAVITIES_AT[0]):
        searching.step()
    assert not searching.upkeep.hollowed  # up to here the two are the same run
    not_searching.load(deepcopy(searching.state()))

    def gap(trainer: Trainer) -> float:
        for _ in range(600 - CONCAVITIES_AT[0]):
            trainer.step()
        points = trainer.frame.points_to_world(trainer.scene.model["position"].detach().numpy().astype(float))
        inside_dent = DENT_RADIUS - np.linalg.norm(points - DENT_AT, axis=-1)
        return float(np.quantile(inside_dent, 0.98))

    without, found = gap(not_searching), gap(searching)
    assert not not_searching.upkeep.hollowed
    assert searching.upkeep.hollowed[0] > 0.01
    assert without > 0.1  # the dent's floor lies deeper than that below the hull
    assert found < 0.6 * without


@pytest.mark.slow
def test_a_run_resumed_at_a_concavity_is_the_same_run(tmp_path, monkeypatch):
    monkeypatch.setattr(upkeep, "CONCAVITIES_AT", (200,))  # soon: where the hollow is found does not matter here
    sources = dented_sources(size=48, count=16)
    trainer = dent_trainer(sources, "on", indirect="traced")
    for _ in range(200):
        trainer.step()
    checkpoint.save(tmp_path, {"trainer": trainer.state()})
    resumed = dent_trainer(sources, "on", indirect="traced")
    saved = checkpoint.load(tmp_path)
    assert saved is not None
    resumed.load(saved["trainer"])
    for _ in range(20):
        trainer.step()
        resumed.step()
    assert trainer.upkeep.hollowed and trainer.upkeep.hollowed == resumed.upkeep.hollowed
    assert all(torch.equal(value, resumed.scene.tensors()[name]) for name, value in trainer.scene.tensors().items())
