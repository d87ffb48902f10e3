"""Maps of a light stage beside the views: where there are some the trained surface follows them, up to the light's unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.geometry.cameras import Camera
from pipeline.rig.surface.read_maps import RigMaps
from stages.train.olat_priors import OlatPriors
from stages.train.parameters import TrainParameters
from stages.train.setup import prepare_training
from stages.train.trainer import Trainer
from stages.train.views.olat_maps import MapPixels, map_pixels
from stages.train.views.training_frame import SceneFrame

from .conftest import ALBEDO, AXES, ROUGHNESS, ellipsoid_hit, look_at

UNIT = np.array([0.5, 0.6, 0.7])  # of the light stage's albedos: its lights are calibrated otherwise
NOISE_DEG = 1.0
TOWARDS = np.array([[1.0, 0.2, 0.3], [-0.6, 0.3, 0.9], [-0.3, 0.1, -1.0]])


def rig_maps(size: int = 48) -> list[RigMaps]:
    """What three cameras that are none of the views' would fit of the ellipsoid, with noise and its standard deviation."""
    rng, out = np.random.default_rng(0), []
    for k, towards in enumerate(TOWARDS):
        camera = Camera(size, size, 1.7 * size, 1.7 * size, size / 2, size / 2, look_at(towards, 4.5))
        hit, normal = ellipsoid_hit(camera)
        shape = (size, size)
        normal = normal + np.radians(NOISE_DEG) / np.sqrt(2) * rng.normal(size=normal.shape)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        there = hit.reshape(shape)

        def image(values: np.ndarray | float, channels: int, there: np.ndarray = there) -> np.ndarray:
            whole = np.broadcast_to(values, (size * size, channels)).reshape(size, size, channels)
            return np.where(there[..., None], whole, 0.0).astype(np.float32)

        noisy = UNIT * ALBEDO * (1 + 0.05 * rng.normal(size=(size * size, 1)))
        maps = {
            "normal": image(normal, 3), "diffuse_albedo": image(noisy, 3), "sigma": image(ROUGHNESS**2, 2),
            "std_diffuse_normal": image(NOISE_DEG, 1), "std_diffuse_albedo": image(0.05 * float(np.mean(UNIT * ALBEDO)), 1),
            "std_sigma": image(0.05 * ROUGHNESS**2, 1),
        }  # fmt: skip
        mask = there.astype(np.float32)
        out.append(RigMaps(f"cam{k:02d}", camera, mask, maps, there, there, (0, 0), shape))
    return out


def trainer_with(sources, maps: list[RigMaps], iterations: int = 120) -> Trainer:
    torch.set_num_threads(1)
    parameters = TrainParameters(
        iterations=iterations, max_splats=1200, hull_resolution=40, environment_resolution=16, indirect="none"
    )
    start = prepare_training(sources, "stokes", {}, "y", parameters, "cpu")
    cameras = [map_pixels(m, "beckmann", "beckmann", start.frame) for m in maps]
    priors = OlatPriors(cameras, "cpu") if cameras else None
    return Trainer(start.scene, start.pyramids, "stokes", start.frame, parameters, "cpu", priors)


def run(trainer: Trainer, steps: int) -> Trainer:
    for _ in range(steps):
        trainer.step()
    return trainer


def normal_error(trainer: Trainer) -> float:
    """Mean angle (degrees) between the splats' normals and the ellipsoid's at the same place."""
    splats, frame = trainer.scene.model.activated(), trainer.frame
    truth = frame.points_to_world(splats.means.detach().numpy().astype(float)) / AXES**2
    truth /= np.linalg.norm(truth, axis=-1, keepdims=True)
    cosine = (truth * frame.directions_to_world(splats.normals.detach().numpy().astype(float))).sum(-1)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


def albedo_error(trainer: Trainer) -> float:
    """Median relative error of the splats' albedo."""
    albedo = trainer.scene.model.activated().albedo.detach().numpy()
    return float(np.median(np.abs(albedo / np.array(ALBEDO) - 1)))


@pytest.mark.slow
def test_maps_bring_normals_closer_to_the_truth_and_their_unit_does_not_matter(make_sources):
    sources = make_sources(32, 12)
    plain = run(trainer_with(sources, []), 120)
    helped = run(trainer_with(sources, rig_maps()), 120)
    assert normal_error(helped) < 0.87 * normal_error(plain)
    assert abs(float(helped.scene.model.activated().roughness.detach().median()) - ROUGHNESS) < 0.015
    assert albedo_error(helped) < albedo_error(plain) + 0.03  # and not 30 to 50 % off, as the maps' unit is


def test_pixels_that_are_flagged_or_noisy_count_less_and_edges_not_at_all():
    maps = rig_maps(24)[0]
    frame = SceneFrame.of("y", np.zeros(3), 1.0)
    plain = map_pixels(maps, "beckmann", "beckmann", frame)
    row, column = divmod(int(plain.view.pixels[len(plain.view.pixels) // 2]), 24)
    noisy = {**maps.maps, "std_diffuse_normal": maps.maps["std_diffuse_normal"].copy()}
    noisy["std_diffuse_normal"][row, column] = 10.0
    lobed = maps.lobed.copy()
    lobed[row, column] = False
    found = map_pixels(replace(maps, maps=noisy, lobed=lobed), "beckmann", "ggx", frame)
    at = found.view.pixels == row * 24 + column
    assert float(plain.normal_weight[at]) == pytest.approx(0.5) and float(found.normal_weight[at]) == pytest.approx(1 / 101)
    assert float(found.roughness_weight[at]) == 0 < float(found.albedo_weight[at])
    elsewhere = ~at
    assert torch.allclose(found.roughness[elsewhere], plain.roughness[elsewhere] * 0.92479**0.5)
    covered = torch.as_tensor(maps.mask.reshape(-1))[found.view.pixels]
    assert len(found.view.pixels) < maps.mask.sum() and bool((covered == 1).all())


def test_a_camera_that_sees_finer_is_averaged_over_blocks():
    maps = rig_maps(48)[0]
    frame = SceneFrame.of("y", np.zeros(3), 1.0)
    fine, coarse = (map_pixels(maps, "beckmann", "beckmann", frame, factor) for factor in (1, 2))
    assert coarse.view.size == (24, 24) and float(coarse.view.intrinsics[0, 0]) == pytest.approx(1.7 * 24)

    def error(pixels: MapPixels) -> float:
        _, true = ellipsoid_hit(pixels.view.camera)
        cosine = (pixels.normal.numpy() * true[pixels.view.pixels.numpy()]).sum(-1)
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())

    assert error(coarse) < 0.7 * error(fine)  # noise of four pixels


def test_albedos_have_one_factor_for_all_cameras(make_sources):
    trainer = trainer_with(make_sources(24, 9), rig_maps(24))
    priors, splats = trainer.priors, trainer.scene.model.activated()
    assert priors is not None
    for turn in range(3):
        terms = priors.terms(splats, turn)
    mean = torch.exp((priors.ratios[:, :3].sum(0) / priors.ratios[:, 3].sum()).double())
    rendered = splats.albedo.detach()[0].double()  # all alike at the start
    assert torch.allclose(mean * torch.as_tensor(UNIT * ALBEDO), rendered, rtol=0.03)
    again = OlatPriors(priors.cameras, "cpu")
    again.load(priors.state())
    assert all(torch.equal(value, again.terms(splats, 2)[name]) for name, value in terms.items())
