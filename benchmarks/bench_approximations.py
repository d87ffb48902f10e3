"""What each approximation of the shading costs and saves: error against a converged reference, against processor time.

    python -m benchmarks.bench_approximations [--out FOLDER]

Fresnel (exact, Schlick), nodes of the split-sum tables, mirrored and diffuse light of a prefiltered environment, rays of the
occlusion. Every case is stored as soon as it is measured; those made with today's defaults are not made again.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch

from benchmarks.bench_shading import made_sky
from benchmarks.case_store import CaseStore, median_s
from pipeline.geometry.rays import RayMesh
from pipeline.optics import fresnel, microfacet
from pipeline.shading import Prefilter, latlong, prefilter, splitsum
from stages.train.parameters import TrainParameters
from stages.train.splats.splat_occlusion import DIFFUSE_RAYS, cosine_rays

FILE = "approximations.json"
ETA, POINTS = 1.5, 200_000
NODES = ((9, 9, 5), (17, 17, 9), (25, 25, 13), (33, 33, 17), (49, 49, 25))
"""Of the split-sum table: roughness, cosine, index of refraction."""
RESOLUTIONS = (8, 16, 32, 64)
RAYS = (12, 24, 48, 96, 192, 384)
MANY_RAYS = 20_000


def defaults() -> dict[str, Any]:
    """What the program does today, of what is measured here."""
    train = TrainParameters()
    return {
        "fresnel": train.fresnel,
        "split_sum_nodes": [splitsum.ROUGHNESS_NODES, splitsum.COSINE_NODES, splitsum.IOR_NODES],
        "environment_resolution": train.environment_resolution,
        "diffuse_resolution": prefilter.DIFFUSE_RESOLUTION,
        "occlusion_rays": DIFFUSE_RAYS,
        "lobe": train.lobe,
    }


def main() -> None:
    """Measure what is not stored yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--captures", help="not used: everything is made here")
    torch.set_num_threads(1)
    store = CaseStore(parser.parse_args().out / FILE, defaults())
    now = store.defaults
    for model in ("exact", "schlick"):
        store.run(f"Fresnel, {model}", lambda m=model: fresnel_case(m), model == now["fresnel"])  # type: ignore[misc]
    for nodes in NODES:
        label = f"split sum, {' x '.join(map(str, nodes))} nodes"
        store.run(label, lambda n=nodes: split_sum_case(n), list(nodes) == now["split_sum_nodes"])  # type: ignore[misc]
    for size in RESOLUTIONS[1:]:
        own = size == now["environment_resolution"]
        store.run(f"mirrored light, cube of {size}", lambda s=size: mirrored_case(s), own)  # type: ignore[misc]
    for size in RESOLUTIONS[:-1]:
        own = size == now["diffuse_resolution"]
        store.run(f"diffuse light, cube of {size}", lambda s=size: diffuse_case(s), own)  # type: ignore[misc]
    for rays in RAYS:
        store.run(f"occlusion, {rays} rays", lambda r=rays: occlusion_case(r), rays == now["occlusion_rays"])  # type: ignore[misc]
    for name, case in store.cases.items():
        print(f"{name:40s} error {case['error']:.4g}  {case['seconds']:.3g} s {case['unit']}")


def fresnel_case(model: str) -> dict[str, Any]:
    """Unpolarised reflectance in float32 against float64, over all angles at an index of 1.5: largest relative error."""
    c = np.linspace(1e-3, 1, POINTS)
    eta = np.full_like(c, ETA)
    exact = fresnel.reflectance(c, eta)
    function = fresnel.reflectance if model == "exact" else fresnel.schlick
    single = c.astype(np.float32), eta.astype(np.float32)
    error = np.abs(function(*single) / exact - 1).max()
    return {"error": float(error), "seconds": median_s(lambda: function(*single)) / POINTS, "unit": "a point"}


@contextmanager
def changed(module: ModuleType, **values: Any) -> Iterator[None]:
    """Constants of a module set to other values for a while; its tables are made anew."""
    before = {name: getattr(module, name) for name in values}
    caches = [f for f in vars(module).values() if hasattr(f, "cache_clear")]
    try:
        for name, value in values.items():
            setattr(module, name, value)
        for cached in caches:
            cached.cache_clear()
        yield
    finally:
        for name, value in before.items():
            setattr(module, name, value)
        for cached in caches:
            cached.cache_clear()


def split_sum_case(nodes: tuple[int, int, int]) -> dict[str, Any]:
    """Directional albedo from the table against quadrature at random points: 95th percentile of the relative error; seconds
    that the table takes to make."""
    rng = np.random.default_rng(0)
    count = 200
    r, c, eta = rng.uniform(0.1, 1, count), rng.uniform(0.05, 0.98, count), rng.uniform(1.3, 2.4, count)
    true = np.empty(count)
    for k in range(count):
        vh, weight, _ = splitsum.reflected(c[k : k + 1], r[k] ** 2, "beckmann", 64, 64)
        true[k] = (weight * fresnel.reflectance(vh, np.asarray(eta[k]))).sum()
    sizes = dict(zip(("ROUGHNESS_NODES", "COSINE_NODES", "IOR_NODES"), nodes))
    with changed(splitsum, **sizes):
        seconds = median_s(lambda: (splitsum.exact_table.cache_clear(), splitsum.exact_table("beckmann")), 1)
        table = torch.as_tensor(splitsum.exact_table("beckmann"))
    low, high = splitsum.IOR_RANGE
    places = ((eta - low) / (high - low) * (nodes[2] - 1), r * (nodes[0] - 1), np.sqrt(c) * (nodes[1] - 1))
    rho = splitsum.lookup(table, tuple(torch.as_tensor(p, dtype=torch.float32) for p in places))[:, 0].numpy()
    error = np.abs(rho * fresnel.reflectance(c, eta) / true - 1)
    return {"error": float(np.percentile(error, 95)), "seconds": seconds, "unit": "for the table"}


def _sky(height: int = 256) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A made sky as directions [D, 3], solid angles [D] and radiance [D, 3]."""
    image = made_sky(height)
    d = latlong.directions(height, 2 * height).reshape(-1, 3)
    rows = np.cos(np.arange(height) * np.pi / height) - np.cos((np.arange(height) + 1) * np.pi / height)
    return d, np.repeat(rows * np.pi / height, 2 * height), image.reshape(-1, 3)


def _axes(count: int) -> np.ndarray:
    axes = np.random.default_rng(0).normal(size=(count, 3))
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _relative(got: np.ndarray, true: np.ndarray) -> float:
    return float(np.median(np.abs(got - true).mean(1) / true.mean(1)))


def mirrored_case(size: int) -> dict[str, Any]:
    """Light of a sky with a sun through a lobe of roughness 0.3: from a cube of so many texels, against the sky's own sum."""
    d, w, radiance = _sky()
    axes, roughness = _axes(120), 0.3
    cosine = np.maximum(axes @ d.T, 0)
    kernel = microfacet.beckmann_distribution(np.sqrt((1 + cosine) / 2), np.asarray(roughness**2)) * cosine * w
    true = kernel @ radiance / kernel.sum(1, keepdims=True)
    filtering, texels = Prefilter(size, "beckmann"), torch.as_tensor(latlong.to_cube(made_sky(), size))
    rough = torch.full((len(axes),), roughness).double()
    got = filtering.apply(texels).mirrored(torch.as_tensor(axes), rough).numpy()
    return {"error": _relative(got, true), "seconds": median_s(lambda: filtering.apply(texels)), "unit": "for an environment"}


def diffuse_case(size: int) -> dict[str, Any]:
    """Irradiance of the same sky from a table of so many texels, against the sum over the sky."""
    d, w, radiance = _sky()
    axes = _axes(200)
    true = (np.maximum(axes @ d.T, 0) * w) @ radiance
    texels = torch.as_tensor(latlong.to_cube(made_sky(), 32))
    with changed(prefilter, DIFFUSE_RESOLUTION=size):
        filtering = Prefilter(32, "beckmann")
        light = filtering.apply(texels)
        got = light.irradiance(torch.as_tensor(axes), transmitted=False).numpy()
        rows = filtering.operator
        seconds = median_s(lambda: rows(light.pyramid))
    return {"error": _relative(got, true), "seconds": seconds, "unit": "for an environment"}


def occlusion_case(rays: int) -> dict[str, Any]:
    """Share of an even sky that a torus leaves to its own vertices, by so many rays: RMS error; seconds a vertex."""
    vertices, faces, normals = _torus()
    surface = RayMesh(vertices, faces)

    def share(count: int, chosen: np.ndarray) -> np.ndarray:
        turn = np.random.default_rng(1).random(len(chosen)).astype(np.float32) * 2 * np.pi
        directions = cosine_rays(count, normals[chosen], turn)
        return 1 - surface.blocked((vertices + 1e-3 * normals)[chosen][:, None], directions).mean(1)

    few = np.arange(0, len(vertices), 7)
    true = np.concatenate([share(MANY_RAYS, few[k : k + 20]) for k in range(0, len(few), 20)])
    error = np.sqrt(((share(rays, few) - true) ** 2).mean())
    every = np.arange(len(vertices))
    return {"error": float(error), "seconds": median_s(lambda: share(rays, every)) / len(every), "unit": "a point"}


def _torus(major: int = 48, minor: int = 24) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A torus that hides its inner side from part of the sky: vertices, triangles, normals."""
    u, v = (np.arange(n) * 2 * np.pi / n for n in (major, minor))
    u, v = (x.ravel() for x in np.meshgrid(u, v, indexing="ij"))
    normals = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], -1).astype(np.float32)
    vertices = (np.stack([np.cos(u), np.sin(u), 0 * u], -1) + 0.45 * normals).astype(np.float32)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(major), np.arange(minor), indexing="ij"))
    a, b = i * minor + j, (i + 1) % major * minor + j
    c, e = (i + 1) % major * minor + (j + 1) % minor, i * minor + (j + 1) % minor
    return vertices, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, e], -1)]), normals


if __name__ == "__main__":
    main()
