"""Highlights tell a lamp inside the scene from distant light, on a glossy ball whose diffuse part is anything."""

import numpy as np
import pytest

from pipeline.geometry.cameras import Camera, camera_from_opengl
from stages.metrics.near_light import BRIGHTEST, _Seen, convergence, places_of
from synth.orbit import look_at, orbit

SIZE = 40


def seen(pose, ways, rng):
    """A ball of radius 1 with a painted diffuse part, under lights; ways: functions of places [H, W, 3] to unit directions."""
    camera = Camera(SIZE, SIZE, 75.0, 75.0, SIZE / 2, SIZE / 2, camera_from_opengl(pose))
    rays, centre = camera.rays(), camera.centre
    along = -(rays @ centre)
    hit = along**2 - centre @ centre + 1
    shown = hit > 0
    place = centre + rays * (along - np.sqrt(np.where(shown, hit, 0)))[..., None]
    normal = place / np.linalg.norm(place, axis=-1, keepdims=True)
    radiance = 0.2 + 0.1 * np.sin(7 * place[..., 0]) * np.sin(5 * place[..., 1] + 2 * place[..., 2])
    for way in ways:
        to = way(place)
        half = to - rays
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        lit = (to * normal).sum(-1).clip(0)
        radiance = radiance + 0.3 * lit + 3 * (half * normal).sum(-1).clip(0) ** 120 * (lit > 0)
    depth = (place - centre) @ camera.world_to_camera[2, :3]
    return _Seen(camera, shown, normal, depth, place, radiance + 0.005 * rng.normal(size=radiance.shape))


def distant(*towards):
    direction = np.array(towards) / np.linalg.norm(towards)
    return lambda place: np.broadcast_to(direction, place.shape)


def lamp(*at):
    def way(place):
        to = np.array(at) - place
        return to / np.linalg.norm(to, axis=-1, keepdims=True)

    return way


def found(*ways):
    rng = np.random.default_rng(1)
    views = [seen(look_at(p), ways, rng) for p in orbit(14, 5.0, -10, 60)]
    places = places_of(views, rng)
    return [convergence(places, share) for share in BRIGHTEST]


@pytest.mark.slow
@pytest.mark.parametrize("distance", [1.8, 4.0])
def test_a_lamp_is_found_with_its_distance(distance):
    at = distance * np.array((0.55, 0.65, 0.52))
    for one in found(lamp(*at)):
        assert one.is_near and one.q == pytest.approx(1 / distance, rel=0.35)
        assert one.direction @ at / np.linalg.norm(at) > 0.98


@pytest.mark.slow
@pytest.mark.parametrize(
    "lights", [[(0.5, 0.7, 0.5)], [(0.5, 0.7, 0.5), (0.2, 0.9, 0.5)], [(1, 0.5, 0), (-1, 0.5, 0), (0, 0.2, 1)]]
)
def test_distant_lights_are_not_near_however_many(lights):
    assert not any(one.is_near for one in found(*[distant(*light) for light in lights]))


@pytest.mark.slow
def test_a_ball_without_highlights_tells_nothing():
    assert not all(one is not None and one.is_near for one in found())
