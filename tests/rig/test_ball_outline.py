"""A ball found by itself: its circle to a fraction of a pixel, and nothing where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.rig.ball_outline import find_ball

SHAPE = (160, 200)
rows, columns = np.indices(SHAPE) + 0.5


def ball(x: float, y: float, radius: float, kind: str, fine: int = 4) -> np.ndarray:
    """A ball on black [H, W] under a dome of light: a matte one's shading, or a dark mirror's rim and highlights."""
    at = [(np.arange(n * fine) + 0.5) / fine for n in SHAPE]
    u, v = (at[1][None] - x) / radius, (at[0][:, None] - y) / radius
    square = u * u + v * v
    z = np.sqrt(np.maximum(1 - square, 0))
    shade = 0.5 + 0.3 * v + 0.2 * z if kind == "matte" else 0.05 + 0.1 * (1 - z) + 20.0 * (np.hypot(u - 0.3, v + 0.4) < 0.05)
    return ((square < 1) * shade).reshape(SHAPE[0], fine, SHAPE[1], fine).mean((1, 3))


@pytest.mark.parametrize("kind", ["matte", "mirror"])
@pytest.mark.parametrize(("x", "y", "radius"), [(80.3, 71.8, 40.0), (140.7, 60.2, 25.3)])
def test_a_ball_is_found_to_a_fraction_of_a_pixel(kind, x, y, radius):
    rng = np.random.default_rng(0)
    picture = ball(x, y, radius, kind) + 0.02 + 0.002 * rng.normal(size=SHAPE)
    found = find_ball(picture)
    assert np.hypot(found.x - x, found.y - y) < 0.3 and abs(found.radius - radius) < 0.3
    assert found.residual < 0.75 and found.covered > 0.9
    assert abs(found.mask(SHAPE).sum() - np.pi * radius**2) < 0.05 * np.pi * radius**2


def test_a_ball_beside_another_object_is_found():
    other = (np.abs(columns - 150) < 30) & (np.abs(rows - 100) < 35)
    found = find_ball(ball(60, 70, 35, "matte") + 0.6 * other)
    assert np.hypot(found.x - 60, found.y - 70) < 0.5


@pytest.mark.parametrize(
    ("picture", "fault"),
    [
        (np.zeros(SHAPE), "black"),
        (((np.abs(columns - 90) < 40) & (np.abs(rows - 80) < 40)).astype(float), "circle"),
        ((np.hypot((columns - 90) / 1.25, rows - 80) < 40).astype(float), "circle"),
        (ball(50, 80, 30, "matte") + ball(145, 80, 30, "matte"), "two circles are as likely"),
        (np.random.default_rng(1).uniform(size=SHAPE), "circle"),
    ],
)
def test_what_is_doubtful_is_refused(picture, fault):
    with pytest.raises(ValueError, match=fault):
        find_ball(picture)
