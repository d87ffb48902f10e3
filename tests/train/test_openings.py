"""Openings: where a view looks into a hollow at a surface's back, no outer side is invented to close it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.formats.backdrop import grown
from pipeline.geometry.cameras import Camera
from pipeline.shading import Prefilter
from stages.train import file_writers
from stages.train.parameters import TrainParameters
from stages.train.render_view import inner_coverage, mean_normals
from stages.train.setup import prepare_training
from stages.train.trainer import Trainer
from stages.train.views.opening_pixels import has_openings, opening_pixels
from stages.train.views.source_views import SourceView
from stages.train.views.view import prepare

from .conftest import look_at, plastic_image, sky

CUT = 0.8  # the unit sphere's shell is open above this height


def flat_source(value: float) -> SourceView:
    camera = Camera(16, 16, 30.0, 30.0, 8.0, 8.0, np.eye(4))
    image = np.full((16, 16, 3, 3), value, np.float32)
    mask = np.zeros((16, 16), np.float32)
    mask[2:14, 2:14] = 1
    return SourceView("000", "train", camera, image, mask, np.ones((16, 16), bool))


def test_black_patches_inside_the_mask_are_openings_and_dead_pixels_are_not():
    source = flat_source(0.25)
    source.image[5:8, 5:8] = 0
    source.image[11, 11] = 0
    source.image[0, 0] = 0
    found = opening_pixels(source, 1.0)
    assert found[5:8, 5:8].all() and found.sum() == 9


def test_a_dark_but_lit_surface_is_no_opening():
    source = flat_source(0.25)
    source.image[5:8, 5:8] = 0.005
    assert not opening_pixels(source, 1.0).any()
    assert not opening_pixels(replace(source, valid=np.zeros((16, 16), bool)), 1.0).any()


def test_the_unlit_half_of_an_object_is_no_opening():
    lit, unlit = flat_source(0.25), flat_source(0.25)
    unlit.image[:, :8] = 0
    assert not has_openings([lit, unlit], 1.0)
    few = flat_source(0.25)
    few.image[5:8, 5:8] = 0
    assert has_openings([lit, few], 1.0)
    assert not has_openings([lit, lit], 1.0)


def bowl_view(camera: Camera, light) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stokes [H, W, 3, 3], mask [H, W] and outward normals [H, W, 3] of the open shell: black from behind."""
    rays, centre = camera.rays().reshape(-1, 3), camera.centre
    b = (rays * centre).sum(-1)
    root = b * b - (centre**2).sum() + 1
    half = np.sqrt(np.maximum(root, 0))
    near, far = centre + rays * (-b - half)[:, None], centre + rays * (-b + half)[:, None]
    front = (root > 0) & (near[:, 1] < CUT)
    back = (root > 0) & ~front & (far[:, 1] < CUT)
    normal = np.where(front[:, None], near, far) * (front | back)[:, None]
    shape = (camera.height, camera.width)
    return plastic_image(camera, front, normal, light), (front | back).reshape(shape), normal.reshape(*shape, 3)


@pytest.mark.slow
def test_a_bowl_stays_open_and_shows_the_normals_of_its_inside():
    torch.set_num_threads(1)
    light = Prefilter(16, "beckmann").apply(sky())
    sources, truths, size = [], {}, 56
    for k in range(20):
        angle = 2.4 * k
        camera = Camera(
            size, size, 1.7 * size, 1.7 * size, size / 2, size / 2,
            look_at(np.array([np.cos(angle), -0.8 + 1.9 * (k % 10) / 10, np.sin(angle)]), 4.5),
        )  # fmt: skip
        stokes, mask, _ = bowl_view(camera.resized(2 * size, 2 * size), light)
        stokes, cover = (a.reshape(size, 2, size, 2, *a.shape[2:]).mean((1, 3)) for a in (stokes, mask))
        full = (cover > 0.99).astype(np.float32)
        name = f"{k:03d}"
        split = "test" if k % 8 == 0 else "train"
        sources.append(SourceView(name, split, camera, stokes.astype(np.float32), full, np.ones(full.shape, bool)))
        truths[name] = bowl_view(camera, light)[2]
    parameters = TrainParameters(
        iterations=900, max_splats=2000, hull_resolution=48, environment_resolution=16, indirect="none", concavities="off"
    )
    start = prepare_training(sources, "stokes", {}, "y", parameters, "cpu")
    assert any(view.openings > 0.05 for view in start.pyramids[0])
    trainer = Trainer(start.scene, start.pyramids, "stokes", start.frame, parameters, "cpu")
    for _ in range(600):
        trainer.step()
    seen = next(s for s in sources if s.split == "test" and opening_pixels(s, start.frame.exposure).sum() > 30)
    hole = opening_pixels(seen, start.frame.exposure)
    blank = replace(seen, mask=np.ones_like(seen.mask))
    view = prepare(blank, start.frame, True)
    with torch.no_grad():
        rendered = trainer.renderer.render_whole(view)
        channels = file_writers.view_channels(rendered, view, start.frame)
        normals = mean_normals(trainer.scene.model.activated(), view, "cpu", True)
        inner = inner_coverage(trainer.scene.model.activated(), view, "cpu")
    assert np.median(channels["alpha"][hole]) < 0.2
    alpha = file_writers.with_inner_sides(channels, inner)["alpha"]
    covered = seen.mask > 0.5
    assert (alpha[hole] > 0.5).mean() > 0.97 and (alpha[covered] > 0.5).mean() > 0.97
    assert (alpha - channels["alpha"])[~grown(covered)].max() < 0.1  # no outline is any wider for it
    filled = file_writers.with_normals(channels, normals, view, start.frame)
    normal = np.stack([filled[f"N.{c}"] for c in "XYZ"], -1)
    error = np.degrees(np.arccos(np.clip((normal * truths[seen.name]).sum(-1), -1, 1)))
    assert np.median(error[hole]) < 12
    outside = channels["alpha"] > 0.6
    before = np.stack([channels[f"N.{c}"] for c in "XYZ"], -1)
    assert np.median(np.degrees(np.arccos(np.clip((normal * before).sum(-1)[outside], -1, 1)))) < 2
