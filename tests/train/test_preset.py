"""`train.preset=paper`: PhyGaP's method as printed, beside what a user gives."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pipeline.engine.stage import parameters_from
from pipeline.shading.environment import activate
from stages.train.log_environment import Environment
from stages.train.parameters import PAPER, TrainParameters
from stages.train.schedule import AGREE_FROM, AGREEMENT, phase_at
from stages.train.setup import prepare_training
from stages.train.stage import STAGE
from stages.train.trainer import Trainer
from stages.train.views import printed_losses as losses
from stages.train.views.view import View, prepare

SMALL = {"max_splats": "600", "hull_resolution": "32", "environment_resolution": "16", "iterations": "100"}


def test_the_preset_gives_what_the_call_does_not():
    paper = parameters_from(STAGE, {"preset": "paper", "weight_smooth": "0.3"}, "PARAMS")
    assert (paper.weight_smooth, paper.weight_polarisation, paper.losses, paper.indirect) == (0.3, 10.0, "printed", "gridmap")
    assert parameters_from(STAGE, {}, "PARAMS") == TrainParameters()
    assert set(PAPER) <= {f.name for f in fields(TrainParameters)}


@pytest.fixture(scope="module")
def paper_trainer(make_sources):
    torch.set_num_threads(1)
    sources = make_sources(32, 12)
    p = parameters_from(STAGE, {"preset": "paper", **SMALL}, "PARAMS")
    start = prepare_training(sources, "stokes", {}, "y", p, "cpu")
    return Trainer(start.scene, start.pyramids, "stokes", start.frame, p, "cpu")


@pytest.mark.slow
@pytest.mark.parametrize("given, late", [({}, AGREEMENT), ({"preset": "paper"}, 1.0)])
def test_normals_must_agree_with_positions_more_at_the_end_but_for_the_printed_losses(given, late):
    trainer = SimpleNamespace(parameters=parameters_from(STAGE, given, "PARAMS"))
    weight = trainer.parameters.weight_depth_normal
    for done, factor in ((0.0, 1.0), (AGREE_FROM - 0.01, 1.0), (AGREE_FROM, late), (1.0, late)):
        assert Trainer.weights(trainer, phase_at(done, 0.3, 0.15)).weight_depth_normal == pytest.approx(factor * weight)


@pytest.mark.slow
def test_the_papers_losses_train(paper_trainer):
    before = paper_trainer.validate()
    found = [paper_trainer.step() for _ in range(60)][-1]
    assert {"rgb", "dssim", "polarisation", "mask", "depth_normal", "smooth"} <= set(found)
    assert paper_trainer.validate() > before + 3  # 8.4


def test_the_environment_is_behind_eq_33():
    environment = Environment(8, 0.68, activation="printed")
    torch.testing.assert_close(environment.radiance(), torch.full((6, 8, 8, 3), 0.68))
    torch.testing.assert_close(environment.radiance(), activate(environment.raw))
    assert float(environment.roughness_of().detach()) == pytest.approx(0, abs=1e-6)


@pytest.fixture(scope="module")
def plane() -> tuple[View, torch.Tensor, torch.Tensor]:
    """(view of a plane that is tilted against it, its normal [3], depths along z [P])."""
    from pipeline.geometry.cameras import Camera
    from stages.train.views.source_views import SourceView
    from stages.train.views.training_frame import SceneFrame

    size = 12
    camera = Camera(size, size, 20.0, 20.0, 6.0, 6.0, np.eye(4))
    image, mask = np.full((size, size, 3, 3), 0.25, np.float32), np.ones((size, size), np.float32)
    source = SourceView("000", "train", camera, image, mask, np.ones(mask.shape, bool))
    view = prepare(source, SceneFrame.of("y", np.zeros(3), 1.0), True)
    normal = torch.nn.functional.normalize(torch.tensor([0.3, -0.2, -1.0]), dim=0)
    rays = -view.view_direction  # towards the plane n.x = n_z 4
    distance = 4 * normal[2] / (rays @ normal)
    return view, normal, distance * (rays @ view.world_to_camera[2, :3])


def test_depths_of_a_plane_have_its_normal(plane):
    view, normal, depth = plane
    count = len(depth)
    alpha = torch.ones(count)
    flat = losses.depth_normal_loss(normal.expand(count, 3), depth, alpha, view)
    assert float(flat) == pytest.approx(0, abs=1e-5)
    away = losses.depth_normal_loss(-normal.expand(count, 3), depth, alpha, view)
    inner = 10 * 10 / count  # a pixel at the rim has no neighbour on one side
    assert float(away) == pytest.approx(2 * inner, rel=1e-4)
    bent = depth.clone().requires_grad_()
    losses.depth_normal_loss(normal.expand(count, 3), bent + 0.1 * bent**2, alpha, view).backward()
    assert torch.isfinite(bent.grad).all() and bent.grad.any()


def test_smoothness_counts_less_where_the_photograph_has_an_edge(plane):
    view, normal, _ = plane
    count = len(view.pixels)
    other = torch.nn.functional.normalize(torch.tensor([0.5, 0.0, -1.0]), dim=0)
    right = (view.pixels % 12 >= 6)[:, None]
    bent = torch.where(right, other, normal)
    even, edge = torch.full((count, 3), 0.2), torch.where(right, 1.2, 0.2).expand(count, 3)
    assert float(losses.smooth_loss(normal.expand(count, 3), even, view)) == pytest.approx(0, abs=1e-5)
    step = float((other - normal).norm()) * 11 / count  # pixels of one column that have a neighbour below
    assert float(losses.smooth_loss(bent, even, view)) == pytest.approx(step, rel=1e-3)
    assert float(losses.smooth_loss(bent, edge, view)) == pytest.approx(step * np.exp(-1), rel=1e-3)


def test_absolute_losses_are_those_of_the_formula(plane):
    view = plane[0]
    target = view.target
    moved = target + torch.tensor([0.1, -0.2, 0.3])[:, None]
    assert float(losses.rgb_loss(moved[:, 0], target[:, 0], view)[0]) == pytest.approx(0.1, rel=1e-4)
    assert float(losses.polarisation_loss(moved, target, view)) == pytest.approx(0.5, rel=1e-4)
    assert float(losses.mask_loss(0.25 * view.alpha_target, view)) == pytest.approx(0.75, rel=1e-4)
