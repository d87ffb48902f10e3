"""Splats of one colour share a material: colours fall into groups or not, and a group's offsets move together."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch

from pipeline.geometry.cameras import Camera
from pipeline.shading import Prefilter, shade
from stages.train.material_groups import HELD, Groups, GroupStep, colour_groups
from stages.train.parameters import TrainParameters
from stages.train.setup import prepare_training
from stages.train.splats.gaussians import SplatModel
from stages.train.trainer import Trainer
from stages.train.upkeep import LATE_FROM
from stages.train.views.source_views import SourceView

from .conftest import look_at, sky

BROWN, BLUE, GREEN = (0.5, 0.35, 0.2), (0.1, 0.12, 0.3), (0.1, 0.4, 0.1)


def noisy(colour, count, spread=0.08):
    rng = np.random.default_rng(count)
    return np.clip(np.array(colour) * np.exp(spread * rng.standard_normal((count, 3))), 0, 1)


@pytest.mark.parametrize("colours", [[BROWN], [BROWN, BLUE], [BROWN, BLUE, GREEN]])
def test_each_colour_is_a_group(colours):
    counts = [700, 300, 200][: len(colours)]
    found = colour_groups(np.concatenate([noisy(c, n) for c, n in zip(colours, counts)]))
    assert found.max() + 1 == len(colours)
    first = np.cumsum([0, *counts])
    for low, high in pairwise(first):
        assert (found[low:high] == np.bincount(found[low:high]).argmax()).mean() > 0.99


@pytest.mark.parametrize("shape", ["bell", "ramp", "fleck", "none"])
def test_what_does_not_fall_apart_is_one_group(shape):
    rng = np.random.default_rng(0)
    share = {"bell": 0.5 + 0.1 * rng.standard_normal(2000), "ramp": np.linspace(0.1, 0.9, 2000)}.get(shape, np.full(2000, 0.5))
    colours = np.clip(share, 0, 1)[:, None] * np.array(BROWN)
    if shape == "fleck":
        colours[:60] = BLUE
    assert not colour_groups(colours[: 0 if shape == "none" else None]).any()


def test_a_groups_mean_is_hardly_held_back():
    of = torch.tensor([0, 0, 1, 1, 1])
    offsets = torch.tensor([[-1.0, 0.2], [-0.6, 0.0], [0.4, 0.0], [0.5, 0.0], [0.6, 0.3]])
    held = Groups.numbered(of).held(offsets)
    for group in (0, 1):
        assert torch.allclose(held[of == group].mean(0), HELD * offsets[of == group].mean(0))
    assert torch.allclose(held[0] - held[1], offsets[0] - offsets[1])


def test_a_group_moves_by_what_all_of_it_agree_on_and_a_resumed_one_too():
    model = SplatModel({"roughness_offset": torch.zeros(400), "ior_offset": torch.zeros(400)})
    groups, whole, half = Groups.numbered(torch.arange(400) % 2), GroupStep(), GroupStep()
    rng = torch.Generator().manual_seed(0)
    for k in range(30):
        agreed = torch.where(groups.of == 0, 1.0, -1.0)
        model["roughness_offset"].grad = agreed + 10 * torch.randn(400, generator=rng)  # a splat alone cannot tell
        if k == 20:
            half.load(whole.state())
            before = model["roughness_offset"].detach().clone()
        if k >= 20:
            again = SplatModel({"roughness_offset": before, "ior_offset": torch.zeros(400)})
            again["roughness_offset"].grad = model["roughness_offset"].grad.clone()
            half.step(again, groups, (0.01, 0.01))
            before = again["roughness_offset"].detach()
        whole.step(model, groups, (0.01, 0.01))
    offset = model["roughness_offset"].detach()
    assert torch.allclose(offset, before, atol=1e-6) and not model["ior_offset"].any()
    assert offset[0::2].max() < -0.1 and offset[1::2].min() > 0.1
    assert offset[0::2].std() < 1e-6 and offset[1::2].std() < 1e-6


def two_coloured_ball(size=32, count=10):
    """Views of a ball, its upper half blue and rough, its lower half brown and glossy."""
    light, out = Prefilter(16, "beckmann").apply(sky()), []
    for k in range(count):
        direction = np.array([np.cos(2.4 * k), -0.7 + 1.4 * k / count, np.sin(2.4 * k)])
        camera = Camera(2 * size, 2 * size, 3.4 * size, 3.4 * size, size, size, look_at(direction, 4.5))
        rays, b = camera.rays().reshape(-1, 3), camera.rays().reshape(-1, 3) @ camera.centre
        root = b * b - (camera.centre**2).sum() + 1
        lit = root > 0
        normal = camera.centre + rays[lit] * (-b[lit] - np.sqrt(root[lit]))[:, None]
        upper = normal[:, 1:2] > 0
        albedo, rough = np.where(upper, BLUE, BROWN), np.where(upper, 0.6, 0.25)[:, 0]
        x, y = (f.reshape(-1, 3)[lit] for f in camera.stokes_frame())
        given = (normal, -rays[lit], albedo, rough, np.full(len(rough), 1.5), x, y)
        stokes = np.zeros((len(rays), 9), np.float32)
        shaded = shade(*(torch.as_tensor(v, dtype=torch.float32) for v in given), light, mirror="lobe-48")
        stokes[lit] = shaded.stokes.reshape(-1, 9)
        image = np.concatenate([stokes, lit[:, None]], 1).reshape(size, 2, size, 2, 10).mean((1, 3))
        mask, small = (image[..., 9] > 0.99).astype(np.float32), camera.resized(size, size)
        out.append(SourceView(f"{k:03d}", "train", small, image[..., :9].reshape(size, size, 3, 3), mask, mask >= 0))
    return out


@pytest.mark.slow
def test_two_colours_of_two_materials_are_told_apart():
    """From one roughness for all, 80 steps: without groups the halves end 0.015 apart."""
    parameters = TrainParameters(
        iterations=400, max_splats=1200, hull_resolution=40, environment_resolution=16, indirect="none", concavities="off"
    )
    torch.set_num_threads(1)
    start = prepare_training(two_coloured_ball(), "stokes", {}, "y", parameters, "cpu")
    trainer, model = Trainer(start.scene, start.pyramids, "stokes", start.frame, parameters, "cpu"), start.scene.model
    upper = model["position"].detach()[:, 1] > 0
    with torch.no_grad():
        model["albedo"].copy_(torch.logit(torch.where(upper[:, None], torch.tensor(BLUE), torch.tensor(BROWN))))
    trainer.iteration = LATE_FROM
    for _ in range(80):
        trainer.step()
    groups = trainer.scene.groups
    assert groups is not None and len(groups.members) == 2 and len(groups.of) == len(model)
    splats = trainer.scene.model.activated()
    blue = splats.albedo[:, 2] > splats.albedo[:, 0]
    rough, glossy = (float(splats.roughness.detach()[rows].median()) for rows in (blue, ~blue))
    assert rough > glossy + 0.05
