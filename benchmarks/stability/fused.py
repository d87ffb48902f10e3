"""The fast kernels against their readable definitions in float64, where they are stiff, and on hostile inputs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch

from benchmarks.stability.verdicts import Row
from pipeline.shading import Prefilter, latlong, shade, shading
from pipeline.shading.prefilter import LightField
from stages.train.rasterize import rasterize
from synth.environments import ENVIRONMENTS

VALUE = 5e-5
"""Off by at most this, of the point's largest Stokes component: float32 through sums of light that spans five decades."""
TREE = 1e-2  # the same, where light is summed over a tree
GRADIENT = 5e-3  # at the 99th percentile, of the largest gradient of the same argument
COSINES = (1.0, 1 - 1e-6, 0.9999, 0.99, 0.8, 0.5, 0.2, 0.05, 0.01, 2e-3, 0.0, -0.3)
ROUGHNESSES = (0.0, 0.05, 0.08, 0.2, 0.5, 0.9, 1.5)
IORS = (1.0, 1.001, 1.3, 1.5, 2.3, 3.0)
RESOLUTION = 32


def _sun(height: int) -> np.ndarray:
    sky = np.full((height, 2 * height, 3), 0.1)
    sky[height // 4, height // 2] = 1e4
    return sky


ENVIRONMENT = {"meadow": ENVIRONMENTS["meadow"], "studio": ENVIRONMENTS["studio"], "sun of 1e5 to 1": _sun}


def rows() -> Iterator[Row]:
    """Shading under each light and mirror, shading of hostile points, and the rasteriser's hostile scenes."""
    for light in ENVIRONMENT:
        for mirror in ("split", "lobe-12", "tree"):
            yield _shading(light, mirror)
    yield _hostile_points()
    for scene in SCENES:
        yield _rasteriser(scene)


def _points() -> list[torch.Tensor]:
    """[normal, view, albedo, roughness, ior, frame_x, frame_y] over the stiff grid, float64."""
    c, r, eta = (torch.as_tensor(x.ravel()) for x in np.meshgrid(COSINES, ROUGHNESSES, IORS, indexing="ij"))
    rng = np.random.default_rng(0)
    view = rng.normal(size=(len(c), 3))
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    side = np.cross(view, rng.normal(size=(len(c), 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    c_ = c.numpy()[:, None]
    normal = c_ * view + np.sqrt((1 - c_) * (1 + c_)) * side
    x = np.cross(-view, (0.0, 1.0, 0.0))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    albedo = torch.as_tensor(rng.uniform(0, 1, (len(c), 3)))
    parts = [torch.as_tensor(v) for v in (normal, view)]
    # Both precisions get the same numbers, so that only the arithmetic differs.
    return [v.float().double() for v in (*parts, albedo, r, eta, torch.as_tensor(x), torch.as_tensor(np.cross(x, -view)))]


def _light(name: str, dtype: torch.dtype) -> tuple[LightField, torch.Tensor]:
    texels = torch.as_tensor(latlong.to_cube(ENVIRONMENT[name](64), RESOLUTION), dtype=torch.float32).to(dtype).requires_grad_()
    return Prefilter(RESOLUTION).apply(texels), texels


def _shaded(
    call: Callable[..., object], name: str, mirror: str, dtype: torch.dtype
) -> tuple[torch.Tensor, list[torch.Tensor], float]:
    """Stokes vectors, gradients of a fixed random sum of them in the five arguments and the texels, and seconds a call."""
    arguments = [v.to(dtype).requires_grad_(k < 5) for k, v in enumerate(_points())]
    light, texels = _light(name, dtype)
    call(*arguments, light, mirror=mirror)  # compiles
    start = time.perf_counter()
    stokes = call(*arguments, light, mirror=mirror).stokes  # type: ignore[attr-defined]
    seconds = time.perf_counter() - start
    weights = torch.randn(stokes.shape, generator=torch.Generator().manual_seed(0)).to(dtype)
    gradients = torch.autograd.grad((stokes * weights).sum(), [*arguments[:5], texels])
    return stokes.detach().double(), [g.double() for g in gradients], seconds


def _shading(name: str, mirror: str) -> Row:
    fast, fast_g, seconds = _shaded(shade, name, mirror, torch.float32)
    slow, slow_g, slow_s = _shaded(shading.plain, name, mirror, torch.float64)
    size = slow.abs().amax((1, 2)).clamp_min(1e-30)
    off = (fast - slow).abs().amax((1, 2)) / size
    finite = all(bool(x.isfinite().all()) for x in (fast, *fast_g))
    slopes = [float(((a - b).abs() / b.abs().max().clamp_min(1e-30)).flatten().quantile(0.99)) for a, b in zip(fast_g, slow_g)]
    worst = int(off.argmax())
    c, r, eta = (x.ravel() for x in np.meshgrid(COSINES, ROUGHNESSES, IORS, indexing="ij"))
    return Row(
        part="kernels", name=f"shade, {mirror}", setting=name,
        figures={
            "value": float(off.max()), "gradient": max(slopes),
            "us": 1e6 * seconds / len(fast), "us_float64": 1e6 * slow_s / len(fast),
        },
        sound=alike(float(off.max()), max(slopes), finite, mirror),
        worst=f"n.v {c[worst]:g}, r {r[worst]:g}, eta {eta[worst]:g}", why="" if finite else "values that are not finite",
    )  # fmt: skip


def alike(off: float, slope: float, finite: bool, mirror: str) -> bool:
    """Whether a kernel's shading is its definition's: largest error of the values, and of the gradients."""
    # The tree cuts light at thresholds, so that two precisions may sum over other leaves.
    return finite and off <= (TREE if mirror == "tree" else VALUE) and slope <= GRADIENT


def _hostile_points() -> Row:
    """NaN, Inf and 1e30 in one argument of one point: the others' values and gradients must not notice."""
    clean = [v.float() for v in _points()]
    light = _light("meadow", torch.float32)[0]
    expected = shade(*clean, light).stokes.detach()
    invalid = 0
    for k in range(5):
        for value in (float("nan"), float("inf"), -float("inf"), 1e30, 0.0):
            arguments = [v.clone().requires_grad_(j < 5) for j, v in enumerate(clean)]
            with torch.no_grad():
                arguments[k][7] = value
            stokes = shade(*arguments, light).stokes
            rest = torch.arange(len(stokes)) != 7
            gradients = torch.autograd.grad(stokes[rest].sum(), arguments[:5], retain_graph=True)
            same = torch.equal(stokes.detach()[rest], expected[rest])
            invalid += not (same and all(bool(g[rest].isfinite().all()) for g in gradients))
    return Row("kernels", "shade, one hostile point", "25 values", {"invalid": invalid}, invalid == 0)


@dataclass(frozen=True)
class Splats:
    """A hostile scene: what is done to some of 200 sound splats, and how far the images may then be off the reference."""

    change: Callable[[list[torch.Tensor]], None]
    bar: float = 1e-4


def _scale(u: float, v: float) -> Callable[[list[torch.Tensor]], None]:
    def change(splats: list[torch.Tensor]) -> None:
        splats[2][:50] *= torch.tensor([u, v], dtype=splats[2].dtype)

    return change


def _set(which: int, value: float) -> Callable[[list[torch.Tensor]], None]:
    def change(splats: list[torch.Tensor]) -> None:
        splats[which][:50] = value

    return change


def _move(factor: float, shift: float = 0.0) -> Callable[[list[torch.Tensor]], None]:
    def change(splats: list[torch.Tensor]) -> None:
        splats[0][:50] = splats[0][:50] * factor + shift

    return change


SCENES = {
    "sound": Splats(lambda splats: None, 1e-5),
    "needles of 1e4:1": Splats(_scale(100.0, 0.01), 2e-3),
    "covering the screen": Splats(_scale(1e3, 1e3), 1e-3),
    "scale 0": Splats(_set(2, 0.0)),
    "scale 1e30": Splats(_set(2, 1e30), 1e-2),
    "scale NaN": Splats(_set(2, float("nan"))),
    "quaternion 0": Splats(_set(1, 0.0)),
    "opacity 2": Splats(_set(3, 2.0), 2e-2),
    "opacity NaN": Splats(_set(3, float("nan"))),
    "behind the camera": Splats(_move(1.0, -20.0)),
    "around the camera": Splats(_move(3.0), 1e-3),
    "far away": Splats(_move(1e15)),
    "centre NaN": Splats(_set(0, float("nan"))),
}


def _splats(dtype: torch.dtype) -> list[torch.Tensor]:
    g = torch.Generator().manual_seed(0)
    parts = [
        torch.randn(200, 3, generator=g) * 0.5 + torch.tensor([0.0, 0.0, 4.0]),
        torch.randn(200, 4, generator=g),
        torch.rand(200, 2, generator=g) * 0.3 + 0.05,
        torch.rand(200, generator=g) * 0.9 + 0.05,
        torch.randn(200, 3, generator=g),
    ]
    return [x.to(dtype) for x in parts]


def _drawn(scene: Splats, dtype: torch.dtype, backend: str) -> tuple[list[torch.Tensor], list[torch.Tensor], float]:
    splats = _splats(dtype)
    scene.change(splats)
    splats = [x.requires_grad_() for x in splats]
    intrinsics = torch.tensor([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]], dtype=dtype)
    start = time.perf_counter()
    raster = rasterize(*splats, torch.eye(4, dtype=dtype), intrinsics, 64, 48, backend=backend)
    images = [raster.features, raster.alpha, raster.normal, raster.depth_expected]
    seconds = time.perf_counter() - start
    weights = torch.Generator().manual_seed(1)
    total = sum((i * torch.randn(i.shape, generator=weights).to(dtype)).sum() for i in images)
    gradients = torch.autograd.grad(total, splats)  # type: ignore[arg-type]
    return [i.detach().double() for i in images], [x.double() for x in gradients], seconds


def _rasteriser(name: str) -> Row:
    scene = SCENES[name]
    _drawn(scene, torch.float32, "cpu")  # compiles
    fast, fast_g, seconds = _drawn(scene, torch.float32, "cpu")
    slow, slow_g, slow_s = _drawn(scene, torch.float64, "reference")
    finite = all(bool(x.isfinite().all()) for x in (*fast, *fast_g))
    off = max(float((a - b).abs().max() / b.abs().max().clamp_min(1e-30)) for a, b in zip(fast, slow))
    slope = max(float((a - b).abs().max() / b.abs().max().clamp_min(1e-30)) for a, b in zip(fast_g, slow_g))
    return Row(
        part="kernels", name="rasterise", setting=name,
        figures={"value": off, "gradient": slope, "ms": 1e3 * seconds, "ms_reference": 1e3 * slow_s},
        sound=finite and off <= scene.bar, why="" if finite else "values that are not finite",
    )  # fmt: skip
