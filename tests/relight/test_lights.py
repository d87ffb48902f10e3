"""Lights that stand in the world: against integrals over the lamp, maps of the same light, and shadows by geometry."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.errors import UserError
from pipeline.geometry.occluder import tangent_frames
from pipeline.optics import fresnel
from stages.relight.deferred import Lamp, ShadingModel, Surface
from stages.relight.light_samples import as_map, samples
from stages.relight.lights_file import DirectionalLight, RectangleLight, SphereLight, read_lights
from stages.relight.placed_lights import PlacedLighting

MODEL = ShadingModel(lobe="beckmann", mirror="tree-fine")


def ball(count: int = 400, roughness: float = 0.4) -> Surface:
    """Points of a unit ball, seen from far along +z."""
    rng = np.random.default_rng(2)
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n[:, 2] = np.abs(n[:, 2]) + 0.1
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    view = np.tile([0.0, 0, 1], (count, 1))
    frames = tangent_frames(view)
    material = np.tile([0.6, 0.4, 0.2, roughness, 1.5], (count, 1))
    return Surface(n, n, view, material, frames[:, 0], frames[:, 1])


LIGHTS = {
    "sphere": SphereLight((0.0, 3.0, 4.0), 1.0, (5.0, 4.0, 3.0)),
    "rectangle": RectangleLight((2.0, 0.0, 3.0), (0.0, 2.0, 0.0), (-1.0, 0.0, 1.0), (3.0, 3.0, 6.0), True),
    "directional": DirectionalLight((1.0, 2.0, 2.0), (2.0, 1.0, 3.0), 20.0),
}


def test_solid_angles_and_irradiance_are_those_of_closed_forms():
    point = np.zeros((1, 3))
    seen = samples(LIGHTS["sphere"], point, 16)
    assert seen.solid_angle.sum() == pytest.approx(2 * np.pi * (1 - np.sqrt(1 - 1 / 25)))
    # A ball of radius r at distance d above a level surface: pi L (r/d)^2, whatever its size.
    above = SphereLight((0.0, 0.0, 2.0), 1.0, (1.0, 1.0, 1.0))
    seen = samples(above, point, 16)
    assert (seen.solid_angle * seen.direction[..., 2]).sum() == pytest.approx(np.pi / 4, rel=2e-3)
    # A rectangle a x b at distance h, over its corner (a form factor of every textbook), four times over its middle.
    a, b, h = 0.5, 1.0, 1.0
    x, y = a / h, b / h
    corner = (x / np.hypot(1, x) * np.arctan(y / np.hypot(1, x)) + y / np.hypot(1, y) * np.arctan(x / np.hypot(1, y))) / 2
    above = RectangleLight((0.0, 0.0, h), (2 * a, 0.0, 0.0), (0.0, -2 * b, 0.0), (1.0, 1.0, 1.0))
    seen = samples(above, point, 16)
    assert (seen.solid_angle * seen.direction[..., 2]).sum() == pytest.approx(4 * corner, rel=2e-3)
    away = RectangleLight((0.0, 0.0, h), (2 * a, 0.0, 0.0), (0.0, 2 * b, 0.0), (1.0, 1.0, 1.0))
    assert samples(away, point, 4).solid_angle.sum() == 0  # it shines to its other side
    seen = samples(LIGHTS["directional"], point, 16)
    axis = np.array([1, 2, 2]) / 3
    assert seen.radiance * (seen.solid_angle * (seen.direction @ axis)).sum() == pytest.approx([2, 1, 3], rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", LIGHTS)
def test_a_lamp_far_away_lights_as_its_map_does(kind):
    far = {
        "sphere": SphereLight((0.0, 3e4, 4e4), 1e4, (5.0, 4.0, 3.0)),
        "rectangle": RectangleLight((2e4, 0.0, 3e4), (0.0, 2e4, 0.0), (-1e4, 0.0, 1e4), (3.0, 3.0, 6.0), True),
        "directional": LIGHTS["directional"],
    }[kind]
    surface = ball()
    got = PlacedLighting([far], MODEL, None).of_view(surface, None)
    want = Lamp(as_map([far], np.zeros(3), "y"), 64, MODEL).stokes(surface)
    peak = want[:, 0].max()
    assert np.abs(got - want).mean() < 0.004 * peak and np.abs(got - want).max() < 0.04 * peak
    assert np.abs(want[:, 1:]).max() > 0.05 * peak  # else polarisation is not tested


def test_diffuse_light_of_a_near_lamp_is_that_of_each_points_own_distance():
    surface = ball(50)
    got = PlacedLighting([SphereLight((0.0, 0.0, 1.5), 0.01, (1e4, 1e4, 1e4))], MODEL, None)._direct(surface)
    to = np.array([0, 0, 1.5]) - surface.position
    distance = np.linalg.norm(to, axis=1)
    cosine = np.maximum((to * surface.normal).sum(1) / distance, 0)
    eta = np.asarray(1.5)
    entering = fresnel.transmittance(cosine, eta) * cosine * np.pi * 1e4 * (0.01 / distance) ** 2
    want = fresnel.transmittance(surface.normal[:, 2], eta) * 0.6 / np.pi * entering
    away = np.abs(surface.normal[:, 2]) < 0.8  # off the highlight
    assert away.sum() > 10 and np.allclose(got[away, 0, 0], want[away], rtol=0.02, atol=2e-3 * want.max())


def test_a_map_of_lights_keeps_their_irradiance_and_turns_with_the_up_axis():
    lights = list(LIGHTS.values())
    y = as_map(lights, np.zeros(3), "y")
    rows = np.arange(len(y) + 1) * np.pi / len(y)
    texel = (np.cos(rows[:-1]) - np.cos(rows[1:])) * np.pi / len(y)
    seen = [samples(light, np.zeros((1, 3)), 32) for light in lights]
    want = sum(s.solid_angle.sum() * s.radiance for s in seen)
    assert (y * texel[:, None, None]).sum((0, 1)) == pytest.approx(want, rel=0.01)
    above = DirectionalLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    assert as_map([above], np.zeros(3), "z")[:8].max() > 0 == as_map([above], np.zeros(3), "z")[8:].max()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no lights"),
        ("[[light]]\nkind = 'spot'", "no kind of light"),
        ("[[light]]\nkind = 'sphere'\ncentre = [0, 0, 1]", "lacks"),
        ("[[light]]\nkind = 'sphere'\ncentre = [0, 0]\nradius = 1\nradiance = [1, 1, 1]", "has 2 numbers"),
        ("[[light]]\nkind = 'sphere'\ncentre = [0, 0, 0]\nradius = 0\nradiance = [1, 1, 1]", "radius"),
        ("[[light]]\nkind = 'sphere'\ncentre = [0, 0, 0]\nradius = 1\nradiance = [1, -1, 1]", "below zero"),
        ("[[light]]\nkind = 'directional'\ntowards = [0, 0, 0]\nirradiance = [1, 1, 1]", "no direction"),
        ("[[light]]\nkind = 'directional'\ntoward = [0, 0, 1]\nirradiance = [1, 1, 1]", "unknown key"),
        ("[[lights]]\nkind = 'directional'", "holds no lights"),
        ("kind = ", "not valid TOML"),
    ],
)
def test_a_file_that_is_no_light_is_refused_by_what_is_wrong(tmp_path, text, said):
    path = tmp_path / "lights.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=said):
        read_lights(path)


def test_json_and_toml_say_the_same(tmp_path):
    (tmp_path / "a.toml").write_text("[[light]]\nkind = 'sphere'\ncentre = [0, 0, 1]\nradius = 0.5\nradiance = [1, 2, 3]\n")
    text = '{"light": [{"kind": "sphere", "centre": [0, 0, 1], "radius": 0.5, "radiance": [1, 2, 3]}]}'
    (tmp_path / "a.json").write_text(text)
    assert read_lights(tmp_path / "a.toml") == read_lights(tmp_path / "a.json") == [SphereLight((0, 0, 1), 0.5, (1, 2, 3))]


class Wall:
    """An occluder that hides whatever lies towards negative x."""

    def starts(self, position, normal):
        return position

    def hidden(self, starts, directions, distances):
        return (directions[:, 0] < 0) & (distances > 1)


def test_only_what_the_mesh_leaves_free_arrives():
    surface = ball(30)
    small = SphereLight((0.0, 3.0, 4.0), 0.2, (5.0, 4.0, 3.0))
    light = PlacedLighting([small], MODEL, None)
    free = light._direct(surface)
    light.occluder = Wall()
    shadowed = light._direct(surface)
    assert (shadowed[:, 0] <= free[:, 0] + 1e-6).all()
    seen = samples(small, surface.position, 8).direction[..., 0]
    left, right = (seen >= 0).all(1), (seen < 0).all(1)
    assert left.any() and right.any()
    assert torch.allclose(torch.as_tensor(shadowed[left]), torch.as_tensor(free[left])) and not shadowed[right].any()
