"""Values that are not finite: without weight they have no say, in a gradient they are counted."""

from __future__ import annotations

import pytest
import torch

from stages.train.splats.optimiser import StepRule, SurfaceAdam
from stages.train.views.losses import radiance_loss, stokes_loss, weighted_mean

BAD = (float("nan"), float("inf"), -float("inf"))


@pytest.mark.parametrize("bad", BAD)
def test_a_value_without_weight_has_no_say_in_a_mean_or_its_gradient(bad):
    weight = torch.tensor([1.0, 0.0, 2.0])
    assert weighted_mean(torch.tensor([1.0, bad, 4.0]), weight) == 3.0
    for loss, shape in ((radiance_loss, (3, 3)), (stokes_loss, (3, 3, 3))):
        predicted = torch.full(shape, 0.5, requires_grad=True)
        target = torch.full(shape, 0.4)
        clean = loss(predicted, target, weight)
        target[1] = bad
        found = loss(predicted, target, weight)
        found.backward()
        assert found == clean and predicted.grad is not None and torch.isfinite(predicted.grad).all()


def test_gradients_that_are_not_finite_are_counted_from_their_first_step():
    tensor = torch.zeros(4, requires_grad=True)
    adam = SurfaceAdam({"position": StepRule(1e-3)})
    for gradient in ([1.0, 1.0, 1.0, 1.0], [1.0, BAD[0], BAD[1], 0.0], [BAD[2], 1.0, 1.0, 1.0]):
        tensor.grad = torch.tensor(gradient)
        adam.step({"position": tensor}, {"": 1.0}, None)
    assert torch.isfinite(tensor).all()
    assert adam.not_finite["position"].tolist() == [3, 2]
    again = SurfaceAdam({"position": StepRule(1e-3)})
    again.load(adam.state())
    assert again.not_finite["position"].tolist() == [3, 2]
