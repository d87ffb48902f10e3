"""The common step of light and albedo: leaves the diffuse product alone, follows their joint gradient, resumes."""

from __future__ import annotations

import torch

from stages.train.splats.albedo_light_scale import RATE, ScaleStep


def pair(albedo_value=0.3):
    environment = torch.zeros(6, 4, 4, 3, requires_grad=True)
    albedo = torch.logit(torch.full((50, 3), albedo_value)).requires_grad_(True)
    return environment, albedo


def test_the_product_of_light_and_albedo_stays():
    environment, albedo = pair()
    environment.grad, albedo.grad = torch.ones_like(environment), torch.zeros_like(albedo)
    before = torch.exp(environment.mean()) * torch.sigmoid(albedo).mean()
    ScaleStep().step(environment, albedo, 1.0)
    assert torch.allclose(environment, torch.full_like(environment, -RATE))
    after = torch.exp(environment.mean()) * torch.sigmoid(albedo).mean()
    assert abs(float((after / before).detach()) - 1) < 1e-4


def test_a_light_too_dark_by_half_is_mended_where_each_texel_alone_is_slow():
    """A mirror of 5 % over a diffuse body: the loss is flat along their common scale, and its bottom is found."""
    truth_light, truth_albedo = 2.0, 0.2
    environment, albedo = pair(0.4)
    scale_step = ScaleStep()
    for _ in range(600):
        light = torch.exp(environment).mean((0, 1, 2))
        diffuse, mirrored = light * torch.sigmoid(albedo).mean(0), 0.05 * light
        loss = ((diffuse - truth_light * truth_albedo) ** 2 + (mirrored - 0.05 * truth_light) ** 2).sum()
        loss.backward()
        scale_step.step(environment, albedo, 1.0)
        environment.grad = albedo.grad = None
    assert abs(float(torch.exp(environment.detach()).mean()) / truth_light - 1) < 0.02


def test_a_resumed_scale_step_goes_on_as_it_would_have():
    straight, (environment, albedo) = ScaleStep(), pair()
    for k in range(4):
        environment.grad, albedo.grad = torch.full_like(environment, 1.0 + k), torch.zeros_like(albedo)
        if k == 2:
            resumed, (again, more) = ScaleStep(), (environment.detach().clone(), albedo.detach().clone())
            resumed.load(straight.state())
        straight.step(environment, albedo, 1.0)
        if k >= 2:
            again.grad, more.grad = environment.grad.clone(), albedo.grad.clone()
            resumed.step(again, more, 1.0)
    assert torch.equal(again, environment.detach()) and torch.equal(more, albedo.detach())
