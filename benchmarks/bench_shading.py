"""Lighting: run time beside error.

    python benchmarks/bench_shading.py                      speed, and errors against quadrature under a made sky
    python benchmarks/bench_shading.py CAPTURE ...          and against the images of captures with ground truth
    POLARFIELD_CAPTURES=FOLDER python benchmarks/bench_shading.py     every such capture in a folder

On a capture, shading gets the true normals, IoR, roughness and environment, and the albedo that makes s0 right at
every pixel unless `gt/material.json` has one. What is then left is the error of the shading itself.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from pipeline.capture import open_capture
from pipeline.formats.images import read_image, read_mask
from pipeline.geometry.occluder import Occluder
from pipeline.optics import microfacet, sphere, stokes
from pipeline.shading import LightField, Occlusion, Prefilter, latlong, shade, shading
from pipeline.shading.cube import cube_directions
from pipeline.shading.gridmap import GridMap
from pipeline.shading.transfer import Transfer

CASES = (
    ("ggx", "schlick", "split"), ("ggx", "exact", "split"), ("ggx", "exact", "lobe-24"),
    ("beckmann", "exact", "split"), ("beckmann", "exact", "lobe-4"), ("beckmann", "exact", "lobe-24"),
)  # fmt: skip


# The paper's GridMap is measured once, beside this case.
GRIDMAP_CASE = {"fresnel": "exact", "mirror": "split"}


def median_ms(call: Callable[[], object], repeats: int = 30) -> float:
    """Median wall time of a call (ms), after two to warm up."""
    times = []
    for _ in range(repeats + 2):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times[2:]))


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
        start = time.perf_counter()
        prefilter = Prefilter(resolution)
        out[f"prefilter {resolution} build_s"] = time.perf_counter() - start
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


def image_errors(got: np.ndarray, truth: np.ndarray) -> dict:
    """Errors of Stokes pixels [P, 3, 3]: s0 (%), DoLP, AoLP where the true DoLP passes 0.05 (degrees)."""
    a, b = got.mean(-1), truth.mean(-1)
    e = 100 * np.abs(a[:, 0] - b[:, 0]) / b[:, 0]
    turn = np.degrees(stokes.angle_difference(stokes.angle(a), stokes.angle(b)))[stokes.degree(b) > 0.05]
    dolp = stokes.degree(a) - stokes.degree(b)
    return {
        "s0_median_pct": float(np.median(e)), "s0_mean_pct": float(e.mean()),
        "dolp_mean": float(np.abs(dolp).mean()), "dolp_bias": float(dolp.mean()),
        "aolp_mean_deg": float(turn.mean()), "aolp_median_deg": float(np.median(turn)),
    }  # fmt: skip


def _pixels(folder: Path, step: int) -> list[dict[str, np.ndarray]]:
    """Foreground pixels of every `step`-th view, away from silhouettes, with the truth about them."""
    from scipy.ndimage import binary_erosion

    capture = open_capture(folder)
    out = []
    for source in capture.views[::step]:
        camera, image = capture.cameras[source.view], source.read().stokes
        normal = read_image(folder / f"gt/normal/{source.view}.exr", ("X", "Y", "Z")).astype(np.float64)
        depth = read_image(folder / f"gt/depth/{source.view}.exr", ("Z",))[..., 0]
        length = np.linalg.norm(normal, axis=-1)
        mask = read_mask(capture.masks[source.view]) & (length > 0.5) & (image[:, :, 0].mean(-1) > 1e-3)
        mask = binary_erosion(mask)
        rays, (x, y) = camera.rays(), camera.stokes_frame()
        forward = np.asarray(camera.world_to_camera)[2, :3]
        points = camera.centre + rays * (depth / (rays @ forward))[..., None]
        out.append({"normal": (normal / np.maximum(length, 0.5)[..., None])[mask], "view": -rays[mask], "x": x[mask],
                    "y": y[mask], "truth": image[mask], "points": points[mask]})  # fmt: skip
    return out


def capture_errors(folder: Path, step: int = 4, resolution: int = 64) -> dict:
    """Shading with everything known against a capture's images."""
    material = json.loads((folder / "gt/material.json").read_text())
    texels = tensor(latlong.to_cube(read_image(folder / "gt/env.hdr", ("R", "G", "B")), resolution))
    views = _pixels(folder, step)
    known = material["diffuse"].get("value")
    mesh = _mesh(folder / "gt/mesh.ply")
    truth = np.concatenate([v["truth"] for v in views])
    out = {}
    for lobe, fresnel, mirror in CASES:
        light = Prefilter(resolution, lobe).apply(texels)
        how = {"fresnel": fresnel, "mirror": mirror}
        for name, occluded in _occluders(
            mesh, texels, light, known or [0.5] * 3, lobe, material["ior"], grid=lobe == "beckmann" and how == GRIDMAP_CASE
        ).items():
            start, got = time.perf_counter(), []
            for v in views:
                count = len(v["normal"])
                roughness = np.full(count, np.sqrt(material["alpha"]))
                shared = [tensor(v[k]) for k in ("normal", "view")]
                rest = [tensor(roughness), torch.full((count,), material["ior"]), tensor(v["x"]), tensor(v["y"]), light]
                occlusion = occluded(v, roughness)
                albedo = tensor(np.broadcast_to(known if known else 1.0, (count, 3)))
                if not known:  # s0 = albedo x body + mirror
                    unit = shade(*shared, albedo, *rest, **how, occlusion=occlusion)
                    body = (tensor(v["truth"])[:, 0] - unit.specular) / unit.diffuse.clamp_min(1e-6)
                    albedo = body.clamp(0, 1)
                got.append(shade(*shared, albedo, *rest, **how, occlusion=occlusion).stokes.numpy())
            seconds = (time.perf_counter() - start) / len(views)
            errors = image_errors(np.concatenate(got), truth)
            out[f"{lobe} {fresnel} {mirror} {name}"] = {**errors, "ms_per_view": 1e3 * seconds}
    return out


def _mesh(path: Path) -> Occluder:
    import open3d

    mesh = open3d.io.read_triangle_mesh(str(path))
    return Occluder(np.asarray(mesh.vertices), np.asarray(mesh.triangles))


def _occluders(
    mesh: Occluder, texels: torch.Tensor, light: LightField, albedo: list[float], lobe: str, ior: float, grid: bool
) -> dict[str, Callable[[dict, np.ndarray], Occlusion | None]]:
    colour = np.broadcast_to(albedo, mesh.vertices.shape)
    transfer = Transfer(mesh, colour, ior=ior)
    surface = transfer.light(texels)
    out: dict[str, Callable[[dict, np.ndarray], Occlusion | None]] = {
        "unoccluded": lambda v, r: None,
        "transfer": lambda v, r: transfer.occlusion(
            transfer.attach(v["points"], v["normal"], v["view"], r, lobe=lobe), surface
        ),
    }
    if grid:
        for weights in ("inverse-square", "printed"):
            anchors = GridMap(mesh, colour, weights=weights, lobe=lobe)
            local = anchors.light(texels, light)
            out[f"GridMap {weights}"] = lambda v, r, g=anchors, l=local: g.occlusion(
                v["points"], v["normal"], v["view"], r, l
            )
    return out


def show(title: str, rows: dict) -> None:
    """Print a table of figures."""
    print(f"\n{title}")
    for name, value in rows.items():
        figures = value if isinstance(value, dict) else {"": value}
        print(f"  {name:42s}" + "  ".join(f"{k} {v:.4g}" for k, v in figures.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="*", type=Path, help="captures with gt/ and Stokes images")
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parser.parse_args()
    captures = list(arguments.captures)
    if not captures and "POLARFIELD_CAPTURES" in os.environ:
        found = sorted(Path(os.environ["POLARFIELD_CAPTURES"]).glob("*/gt/material.json"))
        captures = [p.parents[1] for p in found if open_capture(p.parents[1]).polarisation == "stokes"]
    result = {"speed": speed(), "prefilter against quadrature": prefilter_errors()}
    for folder in captures:
        result[folder.name] = capture_errors(folder)
    for title, rows in result.items():
        show(title, rows)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
