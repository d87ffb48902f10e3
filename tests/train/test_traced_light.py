"""Light that the object hides from and sends to itself while training: what places in shadow send, when it is traced, how far
pixels that mirror the object are believed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pipeline.geometry.rays import RayMesh
from pipeline.shading import Occlusion, Prefilter
from stages.train.indirect.pixel_light import LearntLight
from stages.train.indirect.trust import DISTRUST, trusted
from stages.train.parameters import TrainParameters
from stages.train.splats.blocked_directions import BlockedDirections
from stages.train.splats.carried_hull import CarriedHull
from stages.train.splats.gaussians import Splats, normal_quaternions
from stages.train.splats.splat_occlusion import DIFFUSE_RAYS, SplatOcclusion, outgoing, trace_splats
from stages.train.splats.surface_graph import build_graph
from stages.train.upkeep import CYCLE, Upkeep
from stages.train.views.training_frame import SceneFrame
from stages.train.views.view import prepare
from synth.shape import vase

ALBEDO, GAP = 0.8, 0.4


def trench() -> tuple[CarriedHull, Splats]:
    """Two plates of 2 x 2 that face each other across a narrow gap, and splats on them."""
    across = np.linspace(-1, 1, 15)
    x, y = (a.ravel() for a in np.meshgrid(across, across))
    points = np.concatenate([np.stack([x, y, np.full(225, side * GAP / 2)], -1) for side in (-1, 1)])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], 225, 0)
    cell = np.arange(225).reshape(15, 15)
    a, b, c, d = (q.ravel() for q in (cell[:-1, :-1], cell[:-1, 1:], cell[1:, 1:], cell[1:, :-1]))
    upward = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    triangles = np.concatenate([upward, upward[:, ::-1] + 225])
    hull = CarriedHull(RayMesh(points, triangles), points, triangles, normals, np.arange(450))
    means, facing = torch.as_tensor(points, dtype=torch.float32), torch.as_tensor(normals, dtype=torch.float32)
    splats = Splats(
        means, facing, normal_quaternions(facing), torch.full((450, 2), 0.07), torch.ones(450),
        torch.full((450, 3), ALBEDO), torch.full((450,), 0.5), torch.full((450,), 1.5),
    )  # fmt: skip
    return hull, splats


def on_vase() -> tuple[CarriedHull, Splats]:
    """A vase with a bowl and a waist as hull, and a splat at each of its vertices."""
    shape = vase(96, 72)
    count = len(shape.vertices)
    hull = CarriedHull(
        RayMesh(shape.vertices, shape.faces), shape.vertices, shape.faces, shape.normals, np.arange(count)
    )  # fmt: skip
    means, facing = (torch.as_tensor(np.asarray(a), dtype=torch.float32) for a in (shape.vertices, shape.normals))
    splats = Splats(
        means, facing, normal_quaternions(facing), torch.full((count, 2), 0.03), torch.ones(count),
        torch.full((count, 3), ALBEDO), torch.full((count,), 0.5), torch.full((count,), 1.5),
    )  # fmt: skip
    return hull, splats


@pytest.fixture(scope="module")
def white_sky():
    return Prefilter(8, "beckmann").apply(torch.ones(6, 8, 8, 3))


def bounced_deep_inside(light, bounces: int) -> float:
    """Irradiance off the other plate in the middle of one."""
    hull, splats = trench()
    traced = trace_splats(hull, splats, light, build_graph(splats.means, splats.normals), 0, "exact", bounces)
    assert traced.shadow[112].mean() < 0.3
    return float(traced.bounced[112].mean())


def test_a_wall_in_shadow_sends_less_than_under_the_whole_sky(white_sky):
    _, splats = trench()
    whole = SplatOcclusion(torch.ones(450, 3), torch.zeros(450, 3), 0.0, BlockedDirections(splats.means.numpy(), 0.1))
    towards = np.array([[0.0, 0.0, -1.0]], np.float32)
    open_wall = float(outgoing(splats, np.array([112]), towards, white_sky, "exact", whole).mean()) * np.pi
    once, twice, thrice = (bounced_deep_inside(white_sky, n) for n in (1, 2, 3))
    assert twice < thrice < 0.8 * open_wall
    assert once > thrice  # one bounce takes the other wall to lie under the whole sky


def test_rays_that_need_no_casting_are_those_that_meet_nothing(white_sky, monkeypatch):
    hull, splats = on_vase()
    graph, cast = build_graph(splats.means, splats.normals), []
    packed = RayMesh.blocked_packed

    def traced():
        cast.clear()
        return trace_splats(hull, splats, white_sky, graph, 0, "exact")

    monkeypatch.setattr(RayMesh, "blocked_packed", lambda self, rays: cast.append(len(rays)) or packed(self, rays))
    some, few = traced(), sum(cast)
    monkeypatch.setattr(BlockedDirections, "settle", lambda self: setattr(self, "cells", ~np.zeros_like(self.cells)))
    every, all_ = traced(), sum(cast)
    assert all_ == len(splats.means) * DIFFUSE_RAYS and few < 0.7 * all_
    assert every.blocked * 0.98 < some.blocked <= every.blocked
    assert float((some.shadow - every.shadow).abs().mean()) < 0.01


def test_a_wall_without_sky_sends_on_what_reaches_it_from_the_object(white_sky):
    _, splats = trench()
    dark = SplatOcclusion(torch.zeros(450, 3), torch.full((450, 3), np.pi), 1.0, BlockedDirections(splats.means.numpy(), 0.1))
    whole = SplatOcclusion(torch.ones(450, 3), torch.zeros(450, 3), 0.0, BlockedDirections(splats.means.numpy(), 0.1))
    towards = np.array([[0.0, 0.6, -0.8]], np.float32)
    sent = [float(outgoing(splats, np.array([3]), towards, white_sky, "exact", r).mean()) for r in (dark, whole)]
    assert sent[0] == pytest.approx(sent[1], rel=0.12)  # as bright all around as the sky, which is transmitted at 0.91


@pytest.mark.parametrize(
    "indirect, mode, expected",
    [
        ("traced", "stokes", [0, 100, 200, 300, 400, 500, 600, 700, 800, 1000]),
        ("traced", "polarisers", [200, 400, 600, 800, 1000]),
        ("none", "stokes", []),
    ],
)
def test_light_is_traced_often_at_first_and_once_a_cycle_later(indirect, mode, expected):
    upkeep = SimpleNamespace(parameters=TrainParameters(indirect=indirect), period=CYCLE, mode=mode, traced_level=None)
    steps = [i for i in range(1001) if Upkeep.traces_before(upkeep, i, 0)]  # type: ignore[arg-type]
    assert steps == expected
    # a checkpoint of these steps finds nothing traced, and traces it as the run did that wrote it
    assert indirect == "none" or all(Upkeep.traces_before(upkeep, i, 0) for i in range(CYCLE, 3000, CYCLE))  # type: ignore[arg-type]


def test_pixels_that_mirror_the_object_count_less_until_the_end(make_sources):
    view = prepare(make_sources(24, 2)[1], SceneFrame.of("y", np.zeros(3), 1.0), True)
    count = len(view.pixels)
    unblocked = torch.linspace(0, 1, count)
    zero = torch.zeros(count, 3)
    light = Occlusion(zero, zero, unblocked, zero)
    view = replace(view, colour_weight=torch.full((count,), 2.0))
    torch.testing.assert_close(trusted(view, light, 0.0).colour_weight, 2 * unblocked**DISTRUST)
    torch.testing.assert_close(trusted(view, light, 1.0).colour_weight, view.colour_weight)
    assert trusted(view, None, 0.0) is view
    assert trusted(view, LearntLight(zero, zero, unblocked, zero), 0.0) is view


def test_other_images_have_their_light_traced_at_once():
    upkeep = SimpleNamespace(parameters=TrainParameters(), period=CYCLE, mode="stokes", traced_level=1)
    assert Upkeep.traces_before(upkeep, 333, 0)  # type: ignore[arg-type]
    assert not Upkeep.traces_before(upkeep, 333, 1)  # type: ignore[arg-type]
