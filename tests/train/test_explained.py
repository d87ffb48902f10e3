"""A model that is only rough is not doubted; one that is of the wrong kind is, with the figure and the view."""

import numpy as np
import pytest

from pipeline.report.explained import Explained, doubts, explained

RNG = np.random.default_rng(0)
COUNT = 4000


def picture() -> np.ndarray:
    """Radiance [P, 3] of a shaded object with highlights."""
    shade = RNG.uniform(0.05, 1, (COUNT, 1)) * [0.5, 0.4, 0.3]
    return shade + 4 * (RNG.uniform(size=(COUNT, 1)) > 0.97)


def lines_of(model, target, **more) -> list[str]:
    return doubts({"000": explained(model, target, **more), "008": explained(model, target, **more)})


@pytest.mark.parametrize("gain", [1.0, 0.5, 2.0])
def test_a_rough_model_is_not_doubted(gain):
    target = picture()
    rough = gain * target * np.exp(0.4 * RNG.normal(size=(COUNT, 1)))
    assert lines_of(rough, target) == []


@pytest.mark.parametrize("noise", [0.01, 0.1, 0.3])
def test_noise_is_not_held_against_the_model(noise):
    target = picture()
    assert lines_of(target, target + noise * RNG.normal(size=target.shape), noise=noise) == []


def test_a_picture_without_contrast_is_not_judged_by_it():
    flat = np.full((COUNT, 3), 0.4) + 0.01 * RNG.normal(size=(COUNT, 3))
    assert lines_of(np.full((COUNT, 3), 0.4), flat, noise=0.01) == []
    assert lines_of(np.full((COUNT, 3), 0.42), flat) == []


def test_light_in_other_places_is_reported_with_the_worst_view():
    target = picture()
    wrong = target[RNG.permutation(COUNT)]
    (line,) = doubts({"000": explained(0.9 * target + 0.3 * wrong, target), "008": explained(wrong, target)} | {
        "016": explained(wrong * 1.1, target)})  # fmt: skip
    assert "does not explain" in line and "worst 0" in line and "000" not in line


def test_radiance_far_off_is_reported():
    target = picture()
    (line,) = lines_of(target * np.exp(1.3 * RNG.normal(size=(COUNT, 1))) * (0.2 + target), target)
    assert "by a factor of" in line or "does not explain" in line


@pytest.mark.parametrize(
    ("likeness", "off", "said"),
    [
        (0.499, 0.20, "does not explain"),  # a glass ball
        (0.501, 0.20, "does not explain"),
        (0.63, 0.29, "does not explain"),  # metal
        (0.63, 0.21, "does not explain"),
        (0.80, 0.29, "by a factor of"),  # a naked sun
        (0.75, 0.26, None),  # a sound capture after 60 steps
        (0.74, 0.13, None),  # an underside that no view sees
        (0.37, 0.09, None),
        (None, 0.20, None),
    ],
)
def test_the_less_alike_the_smaller_a_difference_is_borne(likeness, off, said):
    lines = doubts({"000": Explained(likeness, off, None)})
    assert lines == [] if said is None else said in lines[0]


def polarised(sign: float) -> tuple[np.ndarray, np.ndarray]:
    angle = RNG.uniform(0, 6.28, (COUNT, 1))
    truth = 0.1 * np.stack([np.cos(angle) * np.ones(3), np.sin(angle) * np.ones(3)], 1)
    return truth * [[1.0], [sign]], truth


def test_a_mirrored_stokes_frame_is_reported_and_noise_alone_is_not():
    target = picture()
    assert lines_of(target, target, polarised=polarised(1.0)) == []
    (line,) = lines_of(target, target, polarised=polarised(-1.2))
    assert "polarisation" in line and "flip_s2" in line
    model, truth = polarised(1.0)
    noisy = truth + 0.3 * RNG.normal(size=truth.shape)
    assert lines_of(target, target, polarised=(-model, noisy), noise=0.3) == []  # more noise than light: nothing is said


def test_too_few_or_black_pixels_tell_nothing():
    assert explained(np.ones((5, 3)), np.ones((5, 3))).likeness is None
    assert lines_of(np.ones((COUNT, 3)), np.zeros((COUNT, 3))) == []
