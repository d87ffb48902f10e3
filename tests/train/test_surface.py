"""Terms on the surface graph: the fused kernel is its readable twin, and smooth surfaces cost nothing."""

from __future__ import annotations

import pytest
import torch

from stages.train.splats.gaussians import normal_quaternions, unit
from stages.train.splats.surface_graph import build_graph, slope_residual
from stages.train.splats.surface_losses import SurfaceWeights, surface_loss, surface_terms


@pytest.fixture
def sphere():
    generator = torch.Generator().manual_seed(0)
    points = unit(torch.randn(600, 3, generator=generator))
    return points, build_graph(points, points), generator


def test_fused_losses_and_gradients_match_the_definition(sphere):
    points, graph, g = sphere
    raw = [
        points * (1 + 0.02 * torch.randn(600, 1, generator=g)),
        unit(points + 0.1 * torch.randn(600, 3, generator=g)),
        torch.rand(600, 3, generator=g),
        0.1 * torch.randn(600, 2, generator=g),
    ]
    factors = (0.2, 0.1, 0.02, 0.1, 0.01)
    slow = [t.clone().requires_grad_(True) for t in raw]
    fast = [t.clone().requires_grad_(True) for t in raw]
    wanted = (torch.tensor(factors) * surface_terms(graph, *slow)).sum()
    wanted.backward()
    total, parts = surface_loss(graph, *fast, SurfaceWeights(*factors))
    (2 * total).backward()
    assert torch.allclose(total, wanted, rtol=1e-5)
    assert torch.allclose(parts.sum(), total)
    for a, b in zip(fast, slow):
        assert torch.allclose(a.grad, 2 * b.grad, rtol=1e-4, atol=1e-6 * float(b.grad.abs().max()))


def test_a_sphere_costs_no_depth_normal_loss(sphere):
    points, graph, _ = sphere
    assert slope_residual(graph, 3 * points, points).abs().max() < 1e-4  # float32 of short chords


def test_two_sides_of_a_thin_sheet_are_not_neighbours():
    grid = torch.stack(torch.meshgrid(torch.arange(12.0), torch.arange(12.0), indexing="ij"), -1).reshape(-1, 2)
    front = torch.cat([grid, torch.full((144, 1), 0.05)], -1)
    back = torch.cat([grid, torch.full((144, 1), -0.05)], -1)
    up = torch.tensor([0.0, 0.0, 1.0]).expand(144, 3)
    graph = build_graph(torch.cat([front, back]), torch.cat([up, -up]))
    i, j = graph.edges
    assert ((i < 144) == (j < 144)).all() and len(i) > 300


def test_diffusion_keeps_constants_and_the_input(sphere):
    _, graph, g = sphere
    assert torch.allclose(graph.diffuse(torch.full((600, 2), 3.0), 5), torch.tensor(3.0))
    values = torch.randn(600, 3, generator=g)
    before = values.clone()
    assert graph.diffuse(values, 4).std() < 0.5 * values.std()
    assert torch.equal(values, before)


def test_quaternions_carry_z_to_every_normal():
    poles = torch.tensor([[0.0, 0, 1], [0, 0, -1]])
    n = unit(torch.cat([torch.randn(500, 3, generator=torch.Generator().manual_seed(1)), poles]))
    w, x, y, z = torch.nn.functional.normalize(normal_quaternions(n), dim=-1).unbind(-1)
    third = torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
    assert torch.allclose(third, n, atol=1e-5)
