"""DSSIM: scikit-image's value, and a gradient that numerical differentiation confirms."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from stages.train.views.dssim import dssim


def pictures(seed=0, size=(30, 24), border=7):
    """Two like images [H, W, 3] that are 0 near the border, and the flat indices of what is not."""
    rng = np.random.default_rng(seed)
    a = rng.random((*size, 3))
    b = np.clip(a + 0.2 * rng.normal(size=a.shape), 0, 2)
    inside = np.zeros(size, bool)
    inside[border:-border, border:-border] = rng.random((size[0] - 2 * border, size[1] - 2 * border)) < 0.9
    pixels = torch.as_tensor(np.flatnonzero(inside))
    return a * inside[..., None], b * inside[..., None], pixels


def listed(image, pixels):
    return torch.as_tensor(image.reshape(-1, 3))[pixels]


def test_it_is_scikit_images_value():
    a, b, pixels = pictures()
    _, structure = structural_similarity(
        a, b, gaussian_weights=True, use_sample_covariance=False, data_range=1.0, channel_axis=-1, full=True
    )
    expected = (1 - structure).reshape(-1, 3)[pixels.numpy()].mean()
    assert abs(float(dssim(listed(a, pixels), listed(b, pixels), pixels, a.shape[:2])) - expected) < 1e-10


@pytest.mark.slow
def test_its_gradient_is_the_numerical_one():
    a, b, pixels = pictures(1, (20, 19))
    x = listed(a, pixels).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda v: dssim(v, listed(b, pixels), pixels, a.shape[:2]), (x,), atol=1e-7)


def test_equal_images_cost_nothing_and_pull_nowhere():
    a, _, pixels = pictures(2)
    x = listed(a, pixels).float().requires_grad_(True)
    loss = dssim(x, x.detach(), pixels, a.shape[:2])
    loss.backward()
    assert float(loss.detach()) < 1e-6 and float(x.grad.abs().max()) < 1e-5
