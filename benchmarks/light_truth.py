"""What `bench_light` measures on: pixels of captures with ground truth, and how far renderings of them are off."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.capture import open_capture
from pipeline.formats.images import RGB, read_image, read_mask, read_stokes, srgb_encode
from pipeline.formats.ply import Ply
from pipeline.geometry.occluder import Occluder
from pipeline.geometry.rays import RayMesh
from pipeline.optics import fresnel, stokes
from pipeline.shading.shading import mirror_reflection

MOST_PIXELS = 10_000  # of a view: larger ones are sampled on a grid
LEAST_SPLIT = 0.3  # polarisation of mirror and body together from which the two can be told apart: noise grows by its inverse
CAPTURED = "captured"


@dataclass(frozen=True)
class Pixels:
    """P pixels of a view: surface, Stokes frame, material [P, ...], and the truth [P, 3, 3] by the name of the light."""

    points: NDArray
    normal: NDArray
    view: NDArray
    x: NDArray
    y: NDArray
    albedo: NDArray | None
    roughness: NDArray
    ior: NDArray
    truth: dict[str, NDArray]


@dataclass(frozen=True)
class Truth:
    """A capture's mesh, environment maps by the name of the light, and pixels of the views that were relit."""

    occluder: Occluder
    albedo: NDArray  # [V, 3] of the mesh
    maps: dict[str, NDArray]
    views: list[Pixels]


def load(folder: Path) -> Truth:
    """A capture's truth. Where it tells no albedo, pixels have none (the caller solves for it) and the mesh is of 0.5."""
    capture = open_capture(folder)
    ply = Ply(folder / "gt/mesh.ply")
    vertices, faces = ply.vertices(), ply.triangles()
    material = json.loads((folder / "gt/material.json").read_text()) if (folder / "gt/material.json").exists() else {}
    relit = sorted(p for p in (folder / "gt/relight").iterdir() if p.is_dir())
    maps = {CAPTURED: folder / "gt/env.hdr"} | {p.name: folder / "envmaps" / f"{p.name}.hdr" for p in relit}
    if not all(path.exists() for path in maps.values()):
        maps |= {p.name: folder.parent / "envmaps" / f"{p.name}.hdr" for p in relit}
    names = sorted(p.stem for p in relit[0].glob("*.exr"))
    by_name = {source.view: source for source in capture.views}
    mesh = RayMesh(vertices, faces)
    views = [_pixels(folder, capture, by_name[name], mesh, material, [p.name for p in relit]) for name in names]
    albedo = np.full((len(vertices), 3), 0.5)
    if all(v.albedo is not None for v in views):
        from scipy.spatial import cKDTree

        points = np.concatenate([v.points for v in views])
        _, near = cKDTree(points).query(vertices)
        albedo = np.concatenate([v.albedo for v in views])[near]
    return Truth(Occluder(vertices, faces), albedo, {k: read_image(p, RGB) for k, p in maps.items()}, views)


def _pixels(folder: Path, capture: Any, source: Any, mesh: RayMesh, material: dict, relit: list[str]) -> Pixels:
    from scipy.ndimage import binary_erosion

    camera, image, name = capture.cameras[source.view], source.read().stokes, source.view
    normal = read_image(folder / f"gt/normal/{name}.exr", ("X", "Y", "Z")).astype(np.float64)
    length = np.linalg.norm(normal, axis=-1)
    mask = binary_erosion(read_mask(capture.masks[name]) & (length > 0.5) & (image[:, :, 0].mean(-1) > 1e-3))
    step = int(np.ceil(np.sqrt(max(mask.sum(), 1) / MOST_PIXELS)))
    grid = np.zeros_like(mask)
    grid[::step, ::step] = True
    mask &= grid
    rays, (x, y) = camera.rays(), camera.stokes_frame()
    found = mesh.cast(camera.centre, rays[mask])
    # Where the first thing met shows its back, one looks into an opening: a renderer leaves it black.
    shown = found.hit & ((found.normal * rays[mask]).sum(-1) < 0)
    distance = found.distance[shown]
    mask[mask] = shown
    points = camera.centre + rays[mask] * distance[:, None]
    count = int(mask.sum())
    albedo: NDArray | None = None
    if (per_pixel := folder / f"gt/material/{name}.exr").exists():
        values = read_image(per_pixel, (*(f"albedo.{c}" for c in RGB), "roughness", "ior"))[mask]
        albedo, roughness, ior = values[:, :3], values[:, 3], values[:, 4]
    else:
        roughness, ior = np.full(count, np.sqrt(material["alpha"])), np.full(count, material["ior"])
        if "value" in material["diffuse"]:
            albedo = np.broadcast_to(material["diffuse"]["value"], (count, 3))
    truth = {CAPTURED: image[mask]} | {e: read_stokes(folder / f"gt/relight/{e}/{name}.exr")[mask] for e in relit}
    n = (normal / np.maximum(length, 0.5)[..., None])[mask]
    return Pixels(points, n, -rays[mask], x[mask], y[mask], albedo, roughness, ior, truth)


def body_of(pixels: Pixels, image: NDArray, lobe: str = "beckmann") -> tuple[NDArray, NDArray]:
    """The diffuse part [P] of Stokes pixels [P, 3, 3] by its polarisation, colours averaged, and where it can be told [P].

    Mirrored and body light are polarised across and within the plane of incidence, by known shares of theirs: two equations.
    """
    n, x, y = (torch.as_tensor(np.ascontiguousarray(v), dtype=torch.float64) for v in (pixels.normal, pixels.x, pixels.y))
    r, e = (torch.as_tensor(v, dtype=torch.float64) for v in (pixels.roughness, pixels.ior))
    cosine = torch.as_tensor((pixels.normal * pixels.view).sum(-1)).clamp(0.01, 1)
    nx, ny = (n * x).sum(-1), (n * y).sum(-1)
    square = (nx * nx + ny * ny).clamp_min(1e-9)
    along = torch.stack(((nx * nx - ny * ny) / square, 2 * nx * ny / square), -1).numpy()
    _, across = mirror_reflection(n, cosine, r, e, x, y, lobe, "exact")
    mirror, body = (across * square).numpy(), (fresnel.diffuse_polarisation(cosine, e) * square).numpy()
    s = image.mean(-1)
    return (((s[:, 1:] * along).sum(-1) + mirror * s[:, 0]) / (mirror + body)), mirror + body > LEAST_SPLIT


def errors(pixels: list[Pixels], got: list[NDArray], diffuse: list[NDArray], light: str) -> dict[str, float]:
    """Errors of rendered Stokes pixels, and of their diffuse parts [P, 3], over all views together."""
    a, b = np.concatenate(got).astype(float), np.concatenate([p.truth[light] for p in pixels]).astype(float)
    mean_a, mean_b = a.mean(-1), b.mean(-1)
    off = 100 * np.abs(mean_a[:, 0] - mean_b[:, 0]) / mean_b[:, 0].clip(1e-3)
    square = ((srgb_encode(a[:, 0]) - srgb_encode(b[:, 0])) ** 2).mean()
    split = [body_of(p, p.truth[light]) for p in pixels]
    true_body, told = (np.concatenate(v) for v in zip(*split))
    body = np.concatenate(diffuse).mean(-1)
    dolp = stokes.degree(mean_a) - stokes.degree(mean_b)
    seen = stokes.degree(mean_b) > 0.05
    turn = np.degrees(stokes.angle_difference(stokes.angle(mean_a), stokes.angle(mean_b)))[seen]
    return {
        "s0_mean_pct": float(off.mean()),
        "foreground_psnr_db": float(-10 * np.log10(max(square, 1e-12))),
        "diffuse_pct": float(100 * np.abs(body - true_body)[told].mean() / true_body[told].mean()),
        "dolp_mean": float(np.abs(dolp).mean()),
        "aolp_mean_deg": float(np.abs(turn).mean()),
    }
