"""Relighting a light stage: the frames' sum and the fitted maps agree where there is nothing but the surface to see."""

import numpy as np
import pytest

from pipeline.formats.images import write_exr
from pipeline.geometry.cameras import Camera
from pipeline.rig.relighting import relight_frames, relight_maps, relighting_error
from pipeline.rig.solid_angles import fibonacci_sphere

ALBEDO = np.array([0.8, 0.5, 0.2])
SIZE = 24


def ball() -> tuple[np.ndarray, np.ndarray]:
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2.4 - 1.2
    inside = x**2 + y**2 < 0.8
    normal = np.stack([x, -y, np.sqrt(np.clip(1 - x**2 - y**2, 0, None))], -1) * inside[..., None]
    return normal, inside


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """A Lambert ball under 200 lights of irradiance pi: frames, maps as the olat stage writes them, the camera."""
    root = tmp_path_factory.mktemp("stage")
    normal, inside = ball()
    lights = fibonacci_sphere(200)
    names: dict[str, list[str]] = {"cross": [], "parallel": []}
    for k, direction in enumerate(lights):
        image = 0.5 * np.maximum(normal @ direction, 0)[..., None] * ALBEDO
        for name in names:
            path = f"cam00/{name}/{k:06d}.exr"
            write_exr(root / path, {c: image[..., i].astype(np.float32) for i, c in enumerate("RGB")})
            names[name].append(path)
    index = {
        "cameras": {"cam00": {**names, "width": SIZE, "height": SIZE}},
        "lights": {"directions": lights.tolist(), "intensity": [1.0] * len(lights)},
    }
    maps = root / "olat" / "cam00"
    xyz = {c: normal[..., i].astype(np.float32) for i, c in enumerate("XYZ")}
    for name in ("diffuse_normal", "specular_normal"):
        write_exr(maps / f"{name}.exr", xyz)
    write_exr(maps / "tangent.exr", {c: np.zeros((SIZE, SIZE), np.float32) for c in "XYZ"})
    write_exr(maps / "diffuse_albedo.exr", {c: (inside * ALBEDO[i]).astype(np.float32) for i, c in enumerate("RGB")})
    for name in ("specular_albedo", "occlusion_d", "occlusion_s"):
        write_exr(maps / f"{name}.exr", {"Y": (inside * (name != "specular_albedo")).astype(np.float32)})
    write_exr(maps / "sigma.exr", {c: (0.3 * inside).astype(np.float32) for c in "XY"})
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 100.0
    camera = Camera(SIZE, SIZE, 1000.0, 1000.0, SIZE / 2, SIZE / 2, pose, (), "cam00")
    return index, root, maps, camera, inside


def sky(kind: str) -> np.ndarray:
    if kind == "constant":
        return np.ones((32, 64, 3))
    y = np.cos((np.arange(32) + 0.5) / 32 * np.pi)[:, None, None]
    return np.broadcast_to(1 + 0.8 * y, (32, 64, 3)) * np.array([1.0, 0.7, 0.4])


@pytest.mark.slow  # the renderer compiles for some seconds
@pytest.mark.parametrize("kind", ["constant", "gradient"])
def test_the_frames_sum_and_the_maps_agree_on_a_lambert_ball(stage, kind):
    index, root, maps, camera, inside = stage
    summed = relight_frames(index, root, "cam00", [sky(kind)], inside)[0]
    shaded = relight_maps(maps, camera, sky(kind))
    error = relighting_error(summed, shaded, inside)
    assert error.shape == inside.shape and np.all(error[~inside] == 0)
    assert np.median(error[inside]) < 0.01 and error.max() < 0.05


def test_under_a_constant_sky_a_lambert_ball_shows_its_albedo(stage):
    index, root, _, _, inside = stage
    summed = relight_frames(index, root, "cam00", [sky("constant")], inside)[0]
    assert np.allclose(summed[inside], ALBEDO, rtol=0.02)
    assert np.all(summed[~inside] == 0)


@pytest.mark.slow
def test_the_sum_is_linear_in_the_map_and_in_the_lights_irradiance(stage):
    index, root, _, _, inside = stage
    one = relight_frames(index, root, "cam00", [sky("gradient")], inside)[0]
    assert np.allclose(relight_frames(index, root, "cam00", [3 * sky("gradient")], inside)[0], 3 * one, rtol=1e-5)
    dimmer = relight_frames(index, root, "cam00", [sky("gradient")], inside, irradiance=2 * np.pi)[0]
    assert np.allclose(dimmer, one / 2, rtol=1e-5)


@pytest.mark.slow  # the renderer compiles for some seconds
def test_a_lobe_without_a_tangent_of_its_own_is_averaged_over_tangents():
    from pipeline.rig.map_rendering import render_pixels

    lights = fibonacci_sphere(300)
    n = np.array([[0.1, 0.2, 0.97]]) / np.linalg.norm([0.1, 0.2, 0.97])
    view, light, none = np.array([[0.0, 0.0, 1.0]]), np.abs(lights) + 0.1, np.zeros((1, 3))

    def shine(tangent: np.ndarray, sigma: tuple[float, float]) -> np.ndarray:
        widths = np.array([sigma])
        return render_pixels(0, view, n, n, tangent, widths, np.ones(1), lights, light, 0.0)[0, 1]

    first = np.cross([[0.0, 1.0, 0.0]], n)
    second = np.cross(n, first)
    turned = [np.cos(a) * first + np.sin(a) * second for a in np.arange(12) * np.pi / 12]
    mean = np.mean([shine(t, (0.4, 0.15)) for t in turned], 0)
    assert np.allclose(shine(none, (0.4, 0.15)), mean, rtol=0.01)
    assert np.allclose(shine(none, (0.3, 0.3)), shine(first, (0.3, 0.3)), rtol=1e-6)
