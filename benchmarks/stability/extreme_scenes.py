"""Captures at the edge: shapes, surfaces and lights that Mitsuba path-traces, and a base capture spoiled or moved."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import STOKES, read_image, srgb_encode, write_exr, write_png
from synth import mitsuba_scene
from synth.environments import ENVIRONMENTS
from synth.orbit import look_at, orbit
from synth.shape import Shape, glaze, vase, vertex_normals

SIZE, VIEWS, SAMPLES = 64, 12, 64
HALF_FIELD_DEG, DISTANCE, BOUNCES = 14.5, 5.0, 4
EXTENT = 2.0  # of the vase, its longest side
PIXEL_PCT = 100 * 2 * DISTANCE * np.tan(np.radians(HALF_FIELD_DEG)) / SIZE / EXTENT
"""A pixel's footprint on the object, in percent of its size."""
PLASTIC = {"type": "pplastic", "alpha": 0.15, "int_ior": 1.5}
Map = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """What is rendered: shape, surface (Mitsuba's), light, and from which elevations (degrees)."""

    shape: Callable[[], Shape] = vase
    surface: dict[str, Any] = field(default_factory=lambda: dict(PLASTIC))
    light: Callable[[int], Map] = ENVIRONMENTS["meadow"]
    elevations: tuple[float, float] = (-8.0, 62.0)
    views: int = VIEWS


def squeezed(x: float, y: float, z: float) -> Shape:
    """The vase scaled along its axes."""
    shape = vase()
    vertices = shape.vertices * (x, y, z)
    return replace(shape, vertices=vertices, normals=vertex_normals(vertices, shape.faces))


def ball() -> Shape:
    """A unit sphere, as the vase's grid."""
    shape = vase()
    v, u = shape.uv[:, 1], shape.uv[:, 0]
    polar, azimuth = np.pi * (1 - v), 2 * np.pi * u
    points = np.stack((np.sin(polar) * np.cos(azimuth), np.cos(polar), -np.sin(polar) * np.sin(azimuth)), -1)
    return replace(shape, vertices=points, normals=points)


def sun(height: int) -> Map:
    """A sky of 0.1 with a sun of 1e5 times its radiance in one texel."""
    sky = np.full((height, 2 * height, 3), 0.1)
    sky[height // 4, height // 2] = 1e4
    return sky


def lamp(height: int) -> Map:
    """One lamp of 10 degrees, black elsewhere."""
    sky = np.zeros((height, 2 * height, 3))
    row, column, reach = height // 3, height // 2, height // 18
    sky[row - reach // 2 : row + reach // 2 + 1, column - reach // 2 : column + reach // 2 + 1] = 200.0
    return sky


SCENES = {
    "base": Scene(),
    "eight views": Scene(views=8),
    "three views": Scene(views=3),
    "no view from above or below": Scene(elevations=(-3.0, 3.0)),
    "underside that no view sees": Scene(elevations=(45.0, 75.0)),
    "needle 1.5 pixels thick": Scene(lambda: squeezed(0.036, 1.0, 0.036)),
    "plate seen edge-on": Scene(lambda: squeezed(1.0, 1.0, 0.02)),
    "metal": Scene(surface={"type": "roughconductor", "material": "Au", "alpha": 0.15, "distribution": "beckmann"}),
    "glass ball": Scene(ball, {"type": "dielectric", "int_ior": 1.5}),
    "mirror ball": Scene(ball, {**PLASTIC, "alpha": 0.001}),
    "matt black": Scene(surface={**PLASTIC, "alpha": 0.5, "diffuse_reflectance": {"type": "rgb", "value": 1e-4}}),
    "sun of 1e5 to 1": Scene(light=sun),
    "one lamp": Scene(light=lamp),
}


def render(output: Path, scene: Scene) -> None:
    """Write the capture of a scene: full-Stokes EXR, masks, transforms.json."""
    import mitsuba as mi

    mi.set_variant("scalar_spectral_polarized")
    focal = SIZE / 2 / np.tan(np.radians(HALF_FIELD_DEG))
    surface = dict(scene.surface)
    if surface["type"] == "pplastic" and "diffuse_reflectance" not in surface:
        surface["diffuse_reflectance"] = mitsuba_scene.texture(glaze())
    mesh = mitsuba_scene.load_mesh(scene.shape(), surface)
    light = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(scene.light(64), np.float32))}
    world = mi.load_dict({"type": "scene", "object": mesh, "environment": light})
    path = {"type": "path", "max_depth": BOUNCES, "hide_emitters": True}
    frames = []
    for k, position in enumerate(orbit(scene.views, DISTANCE, *scene.elevations)):
        pose, name = look_at(position), f"{k:03d}"
        view = mi.load_dict(mitsuba_scene.sensor(pose, SIZE, SIZE, focal))
        film = mitsuba_scene.render(world, view, {"type": "stokes", "integrator": path}, k, SAMPLES)
        covered = mitsuba_scene.render(world, view, {"type": "aov", "aovs": "d:depth"}, k, 16)["d.T"] > 0
        write_exr(output / "images" / f"{name}.exr", {c: film[c] for c in STOKES})
        write_png(output / "masks" / f"{name}.png", np.where(film["A"] > 0, film["A"], covered))
        frames.append({
            "file_path": f"images/{name}.exr", "mask_path": f"masks/{name}.png", "transform_matrix": pose.tolist(),
        })  # fmt: skip
    shared = {"camera_model": "OPENCV", "fl_x": focal, "fl_y": focal, "cx": SIZE / 2, "cy": SIZE / 2, "w": SIZE, "h": SIZE}
    (output / "transforms.json").write_text(json.dumps({**shared, "frames": frames}, indent=1) + "\n")


def _radiance(change: Callable[[NDArray[np.float32], int], NDArray[np.float32]]) -> Callable[[Path], None]:
    def spoil(capture: Path) -> None:
        for k, path in enumerate(sorted((capture / "images").glob("*.exr"))):
            write_exr(path, dict(zip(STOKES, np.moveaxis(change(read_image(path, STOKES), k), -1, 0))))

    return spoil


def _world(scale: float, shift: float) -> Callable[[Path], None]:
    def spoil(capture: Path) -> None:
        path = capture / "transforms.json"
        table = json.loads(path.read_text())
        for frame in table["frames"]:
            matrix = np.array(frame["transform_matrix"])
            matrix[:3, 3] = matrix[:3, 3] * scale + shift
            frame["transform_matrix"] = matrix.tolist()
        path.write_text(json.dumps(table))

    return spoil


def _not_finite(image: NDArray[np.float32], k: int) -> NDArray[np.float32]:
    rng = np.random.default_rng(k)
    for value in (np.nan, np.inf, -1e30, 1e30):
        image[rng.uniform(size=image.shape[:2]) < 0.01] = value
    return image


def _noisy(image: NDArray[np.float32], k: int) -> NDArray[np.float32]:
    level = 0.1 * image[..., :3].mean(where=image[..., :3] > 0)
    return image + np.random.default_rng(k).normal(0, level, image.shape).astype(np.float32)


def _saturated(image: NDArray[np.float32], k: int) -> NDArray[np.float32]:
    lit = image[..., :3].max(-1)
    level = np.quantile(lit[lit > 0], 0.8)
    image[..., :3] = np.minimum(image[..., :3], level)
    return image


def _eight_bit(capture: Path) -> None:
    for path in sorted((capture / "images").glob("*.exr")):
        image = read_image(path, STOKES)[..., :3]
        write_png(path.with_suffix(".png"), srgb_encode(np.clip(image / 0.8, 0, 1)))
        path.unlink()
    table = capture / "transforms.json"
    table.write_text(table.read_text().replace(".exr", ".png"))


WORLDS = {"world x 1e-3": (1e-3, 0.0), "world x 1e4": (1e4, 0.0), "world shifted by 1e5 of its size": (1.0, 2e5)}
"""Scale and shift of the cases whose world is another."""

SPOILED: dict[str, Callable[[Path], None]] = {
    "black": _radiance(lambda image, k: 0 * image),
    "negative": _radiance(lambda image, k: -np.abs(image)),
    "1 % each of NaN, Inf, -1e30, 1e30": _radiance(_not_finite),
    "noise of 10 %": _radiance(_noisy),
    "20 % saturated": _radiance(_saturated),
    "radiance x 1e-30": _radiance(lambda image, k: image * np.float32(1e-30)),
    "radiance x 1e30": _radiance(lambda image, k: image * np.float32(1e30)),
    **{name: _world(*how) for name, how in WORLDS.items()},
    "8-bit sRGB photographs": _eight_bit,
}
"""What is done to a copy of the base capture."""


def make(folder: Path, name: str) -> Path:
    """The capture of one case in `folder`, made if it is not there."""
    output = folder / "".join(c if c.isalnum() else "-" for c in name)
    if (output / "transforms.json").is_file():
        return output
    shutil.rmtree(output, ignore_errors=True)
    if name in SCENES:
        render(output, SCENES[name])
        return output
    shutil.copytree(make(folder, "base"), output.with_suffix(".part"), dirs_exist_ok=True)
    SPOILED[name](output.with_suffix(".part"))
    output.with_suffix(".part").rename(output)
    return output
