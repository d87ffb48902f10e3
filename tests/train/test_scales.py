"""Units, axes and a sun 1e5 times the sky change neither what is taken for an opening nor where hollows are found."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.geometry.cameras import Camera
from pipeline.shading import Prefilter
from stages.train.evaluate import psnr
from stages.train.parameters import TrainParameters
from stages.train.setup import prepare_training
from stages.train.trainer import Trainer
from stages.train.views.opening_pixels import has_openings, opening_pixels
from stages.train.views.source_views import SourceView, exposure_of

from .conftest import ball_interval, look_at, moved, plastic_image, sky

DENT_AT, DENT_RADIUS = np.array([0.0, 0.15, 1.25]), 0.7  # a ball taken out of the unit ball's front
CUT = 0.85  # the shell is open above this height
TURN = Rotation.from_euler("xyz", [40.0, -70.0, 25.0], degrees=True).as_matrix()
SHIFT = np.array([30.0, -20.0, 10.0])


def pot_view(camera: Camera, light) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stokes [H, W, 3, 3], mask and where an opening shows [H, W] of a dented shell without a lid, black from behind."""
    rays, centre = camera.rays().reshape(-1, 3), camera.centre
    (near, far), (enters, leaves) = ball_interval(camera, np.zeros(3), 1.0), ball_interval(camera, DENT_AT, DENT_RADIUS)
    through = (enters < near) & (near < leaves)
    t = np.where(through, leaves, near)
    hit = np.isfinite(near) & (t < far)
    points = centre + rays * np.where(hit, t, 0.0)[:, None]
    above = hit & ((centre + rays * np.where(hit, near, 0.0)[:, None])[:, 1] > CUT)
    back = above & ((centre + rays * np.where(hit, far, 0.0)[:, None])[:, 1] < CUT)
    front = hit & ~above
    normal = np.where(through[:, None], (DENT_AT - points) / DENT_RADIUS, points)
    shape = (camera.height, camera.width)
    return plastic_image(camera, front, normal, light), (front | back).reshape(shape), back.reshape(shape)


@lru_cache
def pot(sun: float) -> tuple[list[SourceView], list[np.ndarray]]:
    """The pot from around, and what of every view shows the opening."""
    light = Prefilter(16, "beckmann").apply(sky(sun=sun))
    sources, openings, size = [], [], 56
    for k in range(24):
        angle, height = 2.4 * k, -0.5 + 1.7 * (k % 12) / 12
        direction = np.array([np.cos(angle), height, np.sin(angle)])
        camera = Camera(size, size, 1.7 * size, 1.7 * size, size / 2, size / 2, look_at(direction, 4.5))
        images = pot_view(camera.resized(2 * size, 2 * size), light)
        stokes, cover, back = (a.reshape(size, 2, size, 2, *a.shape[2:]).mean((1, 3)) for a in images)
        full = (cover > 0.99).astype(np.float32)
        split = "test" if k % 8 == 0 else "train"
        sources.append(SourceView(f"{k:03d}", split, camera, stokes.astype(np.float32), full, np.ones(full.shape, bool)))
        openings.append(back > 0.99)
    return sources, openings


@lru_cache
def pot_trained(sun: float, scale: float) -> Trainer:
    """A small training of it, past the search for hollows, in a world turned, shifted and scaled."""
    torch.set_num_threads(1)
    sources, _ = pot(sun)
    if scale != 1:
        sources = moved(sources, scale, TURN, scale * SHIFT)
    parameters = TrainParameters(
        iterations=800, max_splats=2500, hull_resolution=48, environment_resolution=16, concavities="on"
    )
    start = prepare_training(sources, "stokes", {}, "y", parameters, "cpu")
    trainer = Trainer(start.scene, start.pyramids, "stokes", start.frame, parameters, "cpu")
    for _ in range(420):
        trainer.step()
    return trainer


@pytest.mark.slow
@pytest.mark.parametrize("sun", [20.0, 1e5])
def test_openings_are_told_from_what_a_sun_leaves_in_the_shade(sun):
    sources, truths = pot(sun)
    exposure = exposure_of(sources)
    assert has_openings(sources, exposure)
    found = np.stack([opening_pixels(s, exposure) for s in sources])
    true = np.stack(truths)
    assert found[true].mean() > 0.98
    assert (found & ~true).sum() < 0.02 * true.sum()


def world_points(trainer: Trainer, scale: float) -> np.ndarray:
    """The splats' positions in the pot's own world."""
    points = trainer.frame.points_to_world(trainer.scene.model["position"].detach().numpy().astype(float))
    return points if scale == 1 else (points / scale - SHIFT) @ TURN


@pytest.mark.slow
def test_hollows_and_openings_are_found_at_every_scale_and_under_a_strong_sun():
    # Measured: 0.143, 0.132, 0.142 of the surface hollowed (scales 1, 1e4, 1e-3), a third to a half of it the dent, whose floor
    # is missed by 0.05 to 0.09 of 0.3. Under a sun of 20 it is test_concavity's dent that is found.
    both = [(pot_trained(1e5, scale), scale) for scale in (1e-3, 1e4)]
    shares = [trainer.upkeep.hollowed[0] for trainer, _ in both]
    assert min(shares) > 0.1
    assert shares[0] == pytest.approx(shares[1], rel=0.25)
    for trainer, scale in both:
        assert all(torch.isfinite(value).all() for value in trainer.scene.tensors().values())
        points = world_points(trainer, scale)
        inside_dent = DENT_RADIUS - np.linalg.norm(points - DENT_AT, axis=-1)
        assert np.quantile(inside_dent, 0.98) < 0.12
        opacity = torch.sigmoid(trainer.scene.model["opacity"].detach()).numpy()
        assert (opacity[points[:, 1] > CUT + 0.05] > 0.3).sum() < 0.005 * len(points)
        assert 15 < trainer.validate() < 60


def test_validation_means_something_in_counts_as_in_radiance():
    target = torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) * 0.5
    wrong = target * 1.1
    in_radiance = psnr(wrong, target, 1.0)
    assert psnr(wrong, target, 0.25 / 2000) == pytest.approx(in_radiance, abs=0.1)
    assert psnr(wrong, target, 0.25 / 1e-9) == pytest.approx(in_radiance, abs=0.1)
