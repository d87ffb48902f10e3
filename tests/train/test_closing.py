"""Holes of a closed surface are closed after training; a film over a hollow, and one before nothing, stay transparent."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.train.initialise.sampling import SurfaceSamples
from stages.train.splats.closing import OPAQUE, close_holes, looked_through
from stages.train.splats.gaussians import SplatModel, logit

COUNT = 3000
SPACING = float(np.sqrt(4 * np.pi / COUNT))


def ball(count: int = COUNT) -> np.ndarray:
    """Even points on the unit sphere, which are its normals too."""
    k = np.arange(count) + 0.5
    height, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), height, across * np.sin(turn)], -1)


def model_of(points: np.ndarray, normals: np.ndarray, faint: np.ndarray) -> SplatModel:
    samples = SurfaceSamples(points, normals, np.full(len(points), SPACING))
    model = SplatModel.from_samples(samples, 0.4, 0.4, 1.5, "cpu")
    with torch.no_grad():
        rows = torch.as_tensor(np.flatnonzero(faint))
        model["opacity"][rows] = logit(0.1)
        model["log_scale"][rows] -= 1.0
    return model


def opacity(model: SplatModel) -> np.ndarray:
    return model.activated().opacities.detach().numpy()


def test_a_hole_in_a_closed_surface_is_closed_with_splats_as_wide_as_their_neighbours():
    points = ball()
    faint = points[:, 1] < -0.95
    model = model_of(points, points, faint)
    assert close_holes(model) == faint.sum()
    assert (opacity(model) >= OPAQUE).all()
    sigma = model.activated().scales.detach().numpy()[:, 0]
    assert sigma[faint].min() > 0.8 * np.median(sigma[~faint])
    assert close_holes(model) == 0


def test_a_film_over_a_hollow_stays_transparent():
    points, film = ball(), ball()
    film = film[film[:, 1] > 0.9]
    bowl = points.copy()
    deep = bowl[:, 1] > 0.9
    bowl[deep, 1] = 1.8 - bowl[deep, 1]  # the cap, turned inside: its outer side still looks up
    normals = points.copy()
    normals[deep] *= (-1, 1, -1)
    model = model_of(
        np.concatenate([bowl, film]), np.concatenate([normals, film]), np.arange(len(bowl) + len(film)) >= len(bowl)
    )
    close_holes(model)
    assert (opacity(model)[len(bowl) :] < OPAQUE).mean() > 0.9


def test_a_film_before_nothing_and_a_model_without_faint_splats_are_left_alone():
    points = ball()
    upper = points[:, 1] > 0
    web = points[upper] + (0.0, 3.0, 0.0)
    faint = np.arange(len(points) + len(web)) >= len(points)
    model = model_of(np.concatenate([points, web]), np.concatenate([points, points[upper]]), faint)
    assert close_holes(model) == 0
    assert close_holes(model_of(points, points, np.zeros(len(points), bool))) == 0
    assert close_holes(model_of(points, points, np.ones(len(points), bool))) == 0


@pytest.mark.parametrize("behind, through", [((0, 0, 1.0), False), ((0, 0, -1.0), True)])
def test_what_lies_behind_a_splat_is_told_by_its_side(behind, through):
    point, up = np.zeros((1, 3)), np.array([[0, 0, 1.0]])
    wall, sides = np.array([[0, 0, -0.5]]), np.array([2.0])
    assert looked_through(point, up, wall, np.array([behind]), sides)[0] == through
