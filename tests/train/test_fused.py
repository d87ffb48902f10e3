"""What training computes in one pass on the CPU is its readable twin in torch, gradients included."""

from __future__ import annotations

import pytest
import torch

from stages.train.log_environment import Environment, mean_step
from stages.train.pixel_attributes import LEAST_ALPHA, pixel_attributes, pixel_attributes_plainly
from stages.train.splats import activation
from stages.train.splats.albedo_light_scale import albedo_pull, albedo_pull_plainly
from stages.train.splats.densify import Activity
from stages.train.splats.gaussians import SplatModel
from stages.train.splats.optimiser import StepRule, SurfaceAdam, adam_update
from stages.train.views import losses

COUNT = 300


@pytest.fixture
def raw():
    """Raw parameters of splats anywhere: normals up and down, saturated sigmoids."""
    draw = torch.Generator().manual_seed(5)
    shapes = {"position": (3,), "normal": (3,), "log_scale": (), "opacity": (), "albedo": (3,)}
    shapes |= {"roughness_offset": (), "ior_offset": ()}
    tensors = {name: 3 * torch.randn(COUNT, *shape, generator=draw) for name, shape in shapes.items()}
    return tensors | {"anchor": tensors["position"], "roughness": torch.tensor(0.3), "ior": torch.tensor(-0.2)}


def close(found, wanted, share=2e-5):
    assert found.shape == wanted.shape
    assert torch.allclose(found, wanted, rtol=share, atol=share * float(wanted.detach().abs().max()) + 1e-12)


def weighed(tensors):
    """A scalar that weighs every entry differently."""
    draw = torch.Generator().manual_seed(7)
    return sum((t * torch.randn(t.shape, generator=draw)).sum() for t in tensors if t.requires_grad)


def test_splats_are_activated_and_taken_as_in_torch(raw):
    """Values, and gradients in every raw tensor, of the rows that a view draws with more attributes beside."""
    rows, extra = torch.arange(0, COUNT, 3), torch.randn(COUNT, 2)
    models, taken = [SplatModel(raw), SplatModel(raw)], []
    extras = [extra.clone().requires_grad_(True) for _ in models]
    for splats, more in zip((models[0].activated(), models[1].activated_plainly()), extras):
        if not taken:
            taken.append(activation.taken_rows(splats, rows, more))
            continue
        columns = torch.cat([splats.normals, splats.albedo, splats.roughness[:, None], splats.ior[:, None], more], -1)
        parts = (splats.means, splats.quaternions, splats.scales, splats.opacities, columns)
        taken.append(tuple(t[rows] for t in parts))
    for found, wanted in zip(*taken):
        close(found, wanted)
    for parts in taken:
        weighed(parts).backward()
    close(extras[0].grad, extras[1].grad)
    for name, wanted in models[1].tensors.items():
        if wanted.grad is not None:
            close(models[0][name].grad, wanted.grad)


def test_pixels_attributes_are_those_of_torch():
    """Also where nothing covers a pixel, and where so little does that its attributes fade."""
    features, alpha = torch.rand(12, 9, 10), torch.rand(12, 9)
    features[0], alpha[0] = 0, 0
    features[1] *= 1e-4
    alpha[1] = LEAST_ALPHA / 2
    results = []
    for attributes in (pixel_attributes, pixel_attributes_plainly):
        given = features.clone().requires_grad_(True), alpha.clone().requires_grad_(True)
        values = attributes(*given, torch.arange(9, 108))
        weighed(values).backward()
        results.append((*values, *(t.grad for t in given)))
    for found, wanted in zip(*results):
        close(found, wanted)


@pytest.mark.parametrize("name", ["radiance_loss", "stokes_loss", "mask_loss"])
def test_losses_are_those_of_torch(name):
    """Values and gradients, with negative radiance and unequal weights."""
    shape = {"radiance_loss": (80, 3), "stokes_loss": (80, 3, 3), "mask_loss": (8, 10)}[name]
    predicted, target = 0.3 * torch.randn(shape), torch.rand(shape) - 0.1
    weight = torch.rand(shape if name == "mask_loss" else 80)
    found, wanted = (predicted.clone().requires_grad_(True) for _ in range(2))
    results = getattr(losses, name)(found, target, weight), getattr(losses, f"{name}_plainly")(wanted, target, weight)
    close(*results)
    for result in results:
        (2 * result).backward()
    close(found.grad, wanted.grad)


def test_the_environments_steps_are_those_of_torch():
    environment = Environment(8, 1.0)
    environment.raw.data.add_(0.1 * torch.randn(environment.raw.shape))
    environment.roughness_of().backward()
    found, environment.raw.grad = environment.raw.grad, None
    wanted = mean_step(environment.raw.reshape(-1, 3), environment.edges)
    close(environment.roughness_of(), wanted)
    wanted.backward()
    close(found, environment.raw.grad)


@pytest.mark.parametrize("rounds", [0, 2])
def test_adam_steps_are_those_of_torch(rounds):
    """Three steps, with an entry that is not finite; gradients are used up."""
    rate, rule = 0.1, StepRule(0.1, rounds)
    wanted, moments = torch.randn(40, 3), (torch.zeros(40, 3), torch.zeros(40, 3))
    tensor, adam = wanted.clone().requires_grad_(True), SurfaceAdam({"x": rule})
    for step in range(1, 4):
        gradient = torch.randn(40, 3)
        gradient[3, 1] = float("nan")
        tensor.grad = gradient.clone()
        adam.step({"x": tensor}, {"": 1.0}, None)
        assert tensor.grad is None
        wanted = wanted - rate * adam_update(*moments, gradient.nan_to_num(nan=0.0), step, rounds > 0)
    close(tensor.detach(), wanted)


def test_the_pull_on_all_albedo_is_that_of_torch(raw):
    albedo = raw["albedo"].clone().requires_grad_(True)
    albedo.grad = torch.randn(albedo.shape)
    for found, wanted in zip(albedo_pull(albedo), albedo_pull_plainly(albedo.detach(), albedo.grad)):
        close(found.detach(), wanted, 1e-4)


def test_a_views_activity_adds_up():
    activity = Activity.empty(5, "cpu")
    for weight in (0.0, 0.5):
        activity.add(torch.tensor([1, 3]), torch.tensor([2.0, 4.0]), torch.tensor([0.5, weight]))
    assert activity.gradient.tolist() == [0, 4, 0, 8, 0]
    assert activity.drawn.tolist() == [0, 2, 0, 1, 0]
