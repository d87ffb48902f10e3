"""The Gaussians with the light that leaves them look as the model does, from cameras that took no part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.splats.cloud import SplatCloud
from pipeline.splats.splat_ply import read_splat_ply
from stages.train.lit.fit import encoded, fit_colours
from stages.train.lit.samples import Samples
from stages.train.lit.write import LitSplats, cameras_around, shown, write_lit
from stages.train.parameters import TrainParameters
from stages.train.setup import prepare_training
from stages.train.trainer import Trainer
from stages.train.views.view import prepare

SMALL = TrainParameters(iterations=300, max_splats=1500, hull_resolution=40, environment_resolution=16, mirror="split")


def test_colours_of_low_degree_are_found_again_and_what_no_camera_sees_takes_its_neighbours():
    rng = np.random.default_rng(0)
    means = rng.normal(size=(20, 3))
    true = rng.normal(0, 0.03, (20, 16, 3))
    true[:, 0] += 0.2
    none = np.zeros(0)
    samples = []
    for centre in 8 * harmonics_directions(60):
        colour = SplatCloud(means, none, none, none, true).colours(centre)[:-1]
        linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
        rows, ones = np.arange(19), np.ones(19, np.float32)
        samples.append(Samples(centre, torch.eye(4), torch.eye(3), (1, 1), rows, np.zeros((19, 2), np.float32), ones, linear))

    def blended(coefficients, s):
        return SplatCloud(means, none, none, none, coefficients).colours(s.centre)[s.rows]

    found = fit_colours(means, samples, 1.0, blended)
    off = np.abs(found[:-1] - true[:-1]).max((0, 2))
    assert off[:9].max() < 5e-3 and off[9:].max() < 0.02  # of 0.1: smoothness holds the third degree back
    near = np.linalg.norm(means[:-1] - means[-1], axis=1).argmin()
    assert np.array_equal(found[-1], found[near])


def harmonics_directions(count: int) -> np.ndarray:
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], -1)


@pytest.mark.slow
def test_lit_splats_look_as_the_model_from_held_back_views(make_sources, tmp_path):
    sources = make_sources(40, 12, sun=2.0)
    torch.set_num_threads(1)
    start = prepare_training(sources, "stokes", {}, "y", SMALL, "cpu")
    trainer = Trainer(start.scene, start.pyramids, "stokes", start.frame, SMALL, "cpu")
    for _ in range(60):
        trainer.step()
    blank = [replace(s, mask=np.ones_like(s.mask), valid=np.ones_like(s.valid)) for s in sources]
    lit = LitSplats(trainer.renderer, start.frame)
    with torch.no_grad():
        learnt = [s for s in blank if s.split != "test"]
        for source in (*learnt, *cameras_around(learnt, start.frame, lit.pixel())):
            view = prepare(source, start.frame, True)
            lit.keep(view, trainer.renderer.render_whole(view))
        assert write_lit(tmp_path, lit, np.zeros(3)) == []
        cloud = read_splat_ply(tmp_path / "splats_lit.ply")
        header = (tmp_path / "splats_lit.ply").read_bytes().split(b"end_header")[0].decode()
        white = float(header.split("divided by ")[1].split()[0]) * start.frame.exposure
        splats = trainer.scene.model.activated()
        for source in (s for s in blank if s.split == "test"):
            view = prepare(source, start.frame, True)
            rendered = trainer.renderer.render_whole(view)
            alpha = rendered.gbuffer.alpha_image.numpy()
            model = np.zeros((alpha.size, 3), np.float32)
            model[view.pixels.numpy()] = rendered.stokes[:, 0].numpy()
            ours = shown(splats, cloud.coefficients, view, "cpu") * alpha[..., None]
            wanted = encoded(model.reshape(*alpha.shape, 3), white)
            assert -10 * np.log10(((ours - wanted) ** 2)[alpha > 0.5].mean()) > 28
    assert (tmp_path / "splats_lit.spz").stat().st_size < 0.3 * (tmp_path / "splats_lit.ply").stat().st_size
