"""Shading: processor time, and errors of the prefiltered levels against quadrature under a made sky.

    python -m benchmarks.bench_shading [--json FILE]

Against the images of captures with ground truth, and with indirect light: `bench_light`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.case_store import made_with, median_s
from pipeline.optics import microfacet, sphere
from pipeline.shading import Prefilter, latlong, shade, shading
from pipeline.shading.cube import cube_directions
from stages.train.parameters import TrainParameters


def median_ms(call: Callable[[], object], repeats: int = 30) -> float:
    """Median processor time of a call (ms), after one to warm up."""
    return 1e3 * median_s(call, repeats)


def tensor(a: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(np.ascontiguousarray(a), dtype=torch.float32)


def made_sky(height: int = 128) -> np.ndarray:
    """Sky, ground, a window and a sun of 0.5 degrees and 2e4 [H, 2H, 3]."""
    d = latlong.directions(height, 2 * height, 4)
    x, y, z = np.moveaxis(d, -1, 0)[..., None]
    sky = np.where(y > 0, np.asarray([0.5, 0.8, 1.4]) * (0.4 + y), np.asarray([0.35, 0.3, 0.2]))
    sky = sky + 6 * np.exp(-(((x - 0.8) / 0.2) ** 2 + ((y - 0.2) / 0.15) ** 2)) * (z > 0)
    sun = np.asarray([0.3, 0.8, -0.52])
    return (sky + 2e4 * (d @ (sun / np.linalg.norm(sun)) > np.cos(np.radians(0.5)))[..., None]).mean(2)


def speed(points: int = 10_000) -> dict:
    """Prefilter and shade, forward and backward."""
    out = {}
    g = torch.Generator().manual_seed(0)
    unit = torch.nn.functional.normalize
    normal = unit(torch.randn(points, 3, generator=g), dim=-1)
    view = unit(normal + 0.9 * unit(torch.randn(points, 3, generator=g), dim=-1), dim=-1)
    x = unit(torch.linalg.cross(-view, torch.tensor([0.0, 1.0, 0.0]).expand(points, 3)), dim=-1)
    free = [normal, view, torch.rand(points, 3, generator=g), torch.rand(points, generator=g),
            1.3 + torch.rand(points, generator=g)]  # fmt: skip
    for leaf in free:
        leaf.requires_grad_()
    cotangent = torch.randn(points, 3, 3, generator=g)
    for resolution in (32, 64):
        start = time.process_time()
        prefilter = Prefilter(resolution)
        out[f"prefilter {resolution} build_s"] = time.process_time() - start
        radiance = torch.rand(6, resolution, resolution, 3, generator=g, requires_grad=True)
        ones = torch.ones(prefilter.operator.size, 3)
        forward = median_ms(lambda p=prefilter, r=radiance: p.apply(r))
        both = median_ms(lambda p=prefilter, r=radiance, o=ones: p.apply(r).packed.backward(o))
        out[f"prefilter {resolution} forward_ms"], out[f"prefilter {resolution} backward_ms"] = forward, both - forward
        light = prefilter.apply(radiance.detach())
        leaf = replace(light, packed=light.packed.detach().requires_grad_())
        functions: dict[str, Callable] = {"fused split": shade}
        if resolution == 32:
            functions["plain split"] = shading.plain
            for mirror in ("lobe-4", "lobe-12", "lobe-24", "tree"):
                functions[f"fused {mirror}"] = partial(shade, mirror=mirror)
        for name, function in functions.items():
            call = lambda f=function, l=leaf: f(*free, x, torch.linalg.cross(x, -view), l)  # noqa: E731
            forward = median_ms(call)
            both = median_ms(lambda c=call: c().stokes.backward(cotangent))
            out[f"shade {name} {resolution} {points} px forward_ms"] = forward
            out[f"shade {name} {resolution} {points} px backward_ms"] = both - forward
    return out


def prefilter_errors(resolution: int = 32, count: int = 300) -> dict:
    """Levels against sums over the same cube cut finer: median and 95th percentile of the relative error (%)."""
    texels = latlong.to_cube(made_sky(), resolution)
    d = cube_directions(3 * resolution).reshape(-1, 3)
    w = np.tile(sphere.cube_solid_angles(3 * resolution).ravel(), 6)
    fine = texels.repeat(3, 1).repeat(3, 2).reshape(-1, 3)
    axes = np.random.default_rng(0).normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    cosine = np.maximum(axes @ d.T, 0)
    light = Prefilter(resolution).apply(torch.as_tensor(texels))
    out = {}
    for roughness in (0.2, 0.25, 0.42, 0.6, 1.0):
        kernel = microfacet.ggx_distribution(np.sqrt((1 + cosine) / 2), np.asarray(roughness**2)) * cosine * w
        got = light.mirrored(torch.as_tensor(axes), torch.full((count,), roughness).double()).numpy()
        out[f"level r={roughness}"] = _percent(got, kernel @ fine / kernel.sum(1, keepdims=True))
    got = light.irradiance(torch.as_tensor(axes), transmitted=False).numpy()
    out["irradiance"] = _percent(got, (cosine * w) @ fine)
    return out


def _percent(got: np.ndarray, truth: np.ndarray) -> dict:
    e = 100 * np.abs(got - truth).mean(1) / truth.mean(1)
    return {"median_pct": float(np.median(e)), "p95_pct": float(np.percentile(e, 95))}


def show(title: str, rows: dict) -> None:
    """Print a table of figures."""
    print(f"\n{title}")
    for name, value in rows.items():
        figures = value if isinstance(value, dict) else {"": value}
        print(f"  {name:42s}" + "  ".join(f"{k} {v:.4g}" for k, v in figures.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parser.parse_args()
    result: dict[str, Any] = {"speed": speed(), "prefilter against quadrature": prefilter_errors()}
    for title, rows in result.items():
        show(title, rows)
    if arguments.json:
        train = TrainParameters()
        result["made"] = made_with({"mirror": train.mirror, "environment_resolution": train.environment_resolution})
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
