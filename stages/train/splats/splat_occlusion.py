"""Self-occlusion while training: shadow and bounced light per splat, blocked reflections per pixel, by ray casting.

The occluder is the visual hull's mesh carried along by the splats, so its topology stays and nothing is meshed anew.
What is traced enters shading as constants (no gradient) and is traced again every few hundred steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from pipeline.geometry.normals import vertex_normals
from pipeline.geometry.rays import RayHits, RayMesh
from pipeline.optics.sphere import cosine_directions
from pipeline.shading import LightField, Occlusion, shade

from ..initialise.hull import HullMesh
from .gaussians import SplatModel, Splats
from .ray_kernels import lobe_directions, turned_directions
from .surface_graph import SurfaceGraph

DIFFUSE_RAYS = 48  # cosine-weighted rays a splat; their noise is averaged over neighbours as well
BOUNCES = 2  # reflections of light between places of the object that are followed
AT_ONCE = 4096  # splats traced at a time: all 3 million rays at once were the run's peak of memory, 0.7 GiB
SHADED_AT_ONCE = 262144  # blocked rays whose ends are shaded at a time
LOBE_RAYS = 6  # rays through a pixel's reflection lobe
SMOOTHING = 2  # diffusion rounds of the traced per-splat values
NEAREST = 4  # splats that carry a hull vertex
LEVEL = 0.25  # of the distance to the last of them, within which inverse-square weights are level: no vertex hangs on one splat
LIFT = 0.7  # splat spacings off the surface at which rays begin: the carried hull is coarser than the splats
SMOOTH_LEVEL = 0.55  # roughness of the light that one diffuse ray stands for: it spans the solid angle about it
GRAZING = 0.02  # cosine below which a reflected ray runs into its own surface and counts as free
FAR_TAIL = 0.999  # share of the lobe that rays are drawn from: the last 0.1 % reaches the horizon
GOLDEN = 0.618034  # golden section: azimuths of successive rays fill the circle evenly


@dataclass(frozen=True)
class CarriedHull:
    """A triangle mesh to cast rays at, and for each vertex the nearest splat (whose material it shows)."""

    rays: RayMesh
    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    splat_of_vertex: np.ndarray

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For rays [M, 3]: whether an outer side is hit [M], and the splat nearest to the hit point [M] (-1: miss).

        A first hit from behind means that the ray began just under the surface: it counts as free.
        """
        rays = np.concatenate((origins, directions), axis=1, dtype=np.float32)
        rows = np.flatnonzero(self.rays.blocked_packed(rays))  # few, so that where they end is asked of these alone
        outer, found = self.met(rays[rows])
        hit, splat = np.zeros(len(directions), bool), np.full(len(directions), -1, np.int64)
        hit[rows[outer]] = True
        splat[rows[outer]] = self.splat_of_vertex[self.triangles[found.triangle, found.corner]]
        return hit, splat

    def met(self, rays: np.ndarray) -> tuple[np.ndarray, RayHits]:
        """Which of rays [M, 6] (origins, then directions) hit an outer side [K], and where these do."""
        found = self.rays.cast_packed(rays)
        outer = np.flatnonzero(found.hit & (np.einsum("mk,mk->m", found.normal, rays[:, 3:]) < 0))
        return outer, found.of(outer)


def carried_hull(hull: HullMesh, model: SplatModel) -> CarriedHull:
    """The hull with every vertex moved as its nearest splats have moved since the start."""
    anchors = model["anchor"].detach().cpu().double().numpy()
    moved = model["position"].detach().cpu().double().numpy() - anchors
    distance, index = cKDTree(anchors).query(hull.vertices, k=min(NEAREST, len(anchors)))
    weight = 1 / (distance**2 + (LEVEL * np.median(distance[:, -1])) ** 2)
    weight /= weight.sum(-1, keepdims=True)
    vertices = hull.vertices + (weight[..., None] * moved[index]).sum(1)
    return CarriedHull(
        RayMesh(vertices, hull.triangles), vertices, hull.triangles, vertex_normals(vertices, hull.triangles), index[:, 0]
    )


@dataclass(frozen=True)
class SplatOcclusion:
    """Per splat: shadow [N, 3] (share of the irradiance that arrives) and bounced [N, 3] (irradiance off the object);
    `blocked`: mean share of blocked rays, 0 for a convex object."""

    shadow: torch.Tensor
    bounced: torch.Tensor
    blocked: float


def trace_splats(
    occluder: CarriedHull,
    splats: Splats,
    light: LightField,
    graph: SurfaceGraph,
    seed: int,
    fresnel: str,
    bounces: int = BOUNCES,
) -> SplatOcclusion:
    """Shadow and bounced light, diffuse and specular, at every splat, under the current light and material.

    Args:
        occluder: the object as rays see it.
        splats: N Gaussians; no gradient is taken.
        light: prefiltered environment.
        graph: over which the traced values are smoothed, and whose spacing lifts the rays off the surface.
        seed: of each splat's turn of the ray pattern.
        fresnel: "exact" or "schlick".
        bounces: reflections that are followed; with 1, what rays meet is lit by the whole sky.
    """
    normals = splats.normals.detach().cpu().numpy().astype(np.float32)
    origins = splats.means.detach().cpu().numpy().astype(np.float32) + LIFT * graph.spacing * normals
    turn = np.random.default_rng(seed).random(len(normals)).astype(np.float32) * 2 * np.pi
    parts = []
    for first in range(0, len(normals), AT_ONCE):
        rows = slice(first, first + AT_ONCE)
        parts.append(_trace_rows(occluder, light, origins[rows], normals[rows], turn[rows], first))
    shares, *hits = zip(*parts)
    ray, splat, towards = (np.concatenate(a) for a in hits)
    shadow = graph.diffuse(torch.cat(shares), SMOOTHING)
    blocked = len(ray) / (len(normals) * DIFFUSE_RAYS)
    found = SplatOcclusion(shadow, torch.zeros_like(shadow), blocked)
    receiver = torch.as_tensor(ray, device=shadow.device)
    for _ in range(bounces if len(ray) else 0):
        sent = outgoing(splats, splat, towards, light, fresnel, lit(found, bounces))
        total = torch.zeros_like(shadow).index_add_(0, receiver, sent)
        found = replace(found, bounced=graph.diffuse(np.pi / DIFFUSE_RAYS * total, SMOOTHING))
    return found


def _trace_rows(
    occluder: CarriedHull, light: LightField, origins: np.ndarray, normals: np.ndarray, turn: np.ndarray, first: int
) -> tuple[torch.Tensor, np.ndarray, np.ndarray, np.ndarray]:
    """Shadow [R, 3] at some of the splats, and of their rays that are blocked: the splat they start from (numbered from
    `first`), the one they hit, and their direction [M, 3]."""
    device = light.packed.device
    flat = cosine_rays(DIFFUSE_RAYS, normals, turn).reshape(-1, 3)
    hit, splat = occluder.cast(np.repeat(origins, DIFFUSE_RAYS, 0), flat)
    roughness = torch.full((len(flat),), SMOOTH_LEVEL, device=device)
    radiance = light.mirrored(torch.as_tensor(flat, device=device), roughness)
    open_ = torch.as_tensor(~hit, device=device)[:, None]
    total = radiance.reshape(-1, DIFFUSE_RAYS, 3).sum(1)
    arriving = (radiance * open_).reshape(-1, DIFFUSE_RAYS, 3).sum(1)
    rows = np.flatnonzero(hit)
    return arriving / total.clamp_min(1e-12), first + rows // DIFFUSE_RAYS, splat[rows], flat[rows]


def outgoing(
    splats: Splats, rows: np.ndarray, towards: np.ndarray, light: LightField, fresnel: str, received: SplatOcclusion
) -> torch.Tensor:
    """Radiance [M, 3] that splats `rows` send back along the incoming directions `towards` [M, 3].

    received: shadow and bounced light there; a reflection is blocked and replaced as the diffuse light is. What lies beside a
    crease is in its shadow: lit by the whole sky it would send up to twice as much.
    """
    device = splats.means.device
    parts = []
    for first in range(0, len(rows), SHADED_AT_ONCE):
        r = torch.as_tensor(rows[first : first + SHADED_AT_ONCE], device=device)
        view = torch.as_tensor(-towards[first : first + SHADED_AT_ONCE], device=device)
        frame = torch.zeros_like(view)  # only s0 is wanted
        shadow, bounced = received.shadow[r], received.bounced[r]
        out = shade(
            splats.normals.detach()[r],
            view,
            splats.albedo.detach()[r],
            splats.roughness.detach()[r],
            splats.ior.detach()[r],
            frame,
            frame,
            light,
            occlusion=Occlusion(shadow, bounced, shadow.mean(-1), bounced / np.pi),
            fresnel=fresnel,
        )
        parts.append(out.stokes[:, 0])
    return torch.cat(parts)


def lit(found: SplatOcclusion, bounces: int) -> SplatOcclusion:
    """What the places that rays meet receive: what was found there, or, where one bounce alone is followed, the whole sky."""
    if bounces > 1:
        return found
    return replace(found, shadow=torch.ones_like(found.shadow), bounced=torch.zeros_like(found.bounced))


def trace_pixels(
    occluder: CarriedHull,
    splats: Splats,
    light: LightField,
    points: np.ndarray,
    normals: np.ndarray,
    view_direction: np.ndarray,
    roughness: np.ndarray,
    spacing: float,
    seed: int,
    fresnel: str,
    received: SplatOcclusion,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The reflection lobe of P pixels, sampled by LOBE_RAYS rays each.

    Args:
        occluder, splats, light, seed, fresnel: as in `trace_splats`.
        points, normals, view_direction: on the surface, unit, unit and towards the camera; training frame. [P, 3]
        roughness: perceptual. [P]
        spacing: mean distance between neighbouring splats.
        received: what the splats receive themselves, as `trace_splats` found it.

    Returns:
        Share of the lobe that leaves the object [P], and the object's mean radiance over the lobe, 0 where a ray leaves [P, 3].
    """
    device = splats.means.device
    rng = np.random.default_rng(seed)
    count = len(points)
    u = FAR_TAIL * (np.arange(LOBE_RAYS) + rng.random((count, LOBE_RAYS))) / LOBE_RAYS
    angle = 2 * np.pi * ((np.arange(LOBE_RAYS) * GOLDEN + rng.random((count, 1))) % 1.0)
    reflected, rise = np.empty((count, LOBE_RAYS, 3), np.float32), np.empty((count, LOBE_RAYS), np.float32)
    single = [np.ascontiguousarray(a, np.float32) for a in (normals, view_direction, roughness, u, angle)]
    lobe_directions(*single, reflected, rise)
    flat = reflected.reshape(-1, 3)
    origins = np.repeat(points + LIFT * spacing * normals, LOBE_RAYS, 0)
    hit, splat = occluder.cast(origins, flat)
    hit &= rise.reshape(-1) > GRAZING
    seen = torch.zeros(len(flat), 3, device=device)
    if hit.any():
        seen[torch.as_tensor(np.flatnonzero(hit), device=device)] = outgoing(
            splats, splat[hit], flat[hit], light, fresnel, received
        )
    unblocked = 1 - torch.as_tensor(hit.reshape(count, LOBE_RAYS).astype(np.float32).mean(1), device=device)
    return unblocked, seen.reshape(count, LOBE_RAYS, 3).mean(1)


def cosine_rays(count: int, normals: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The cosine-weighted directions about each of the normals [P, 3], turned by `turn` [P] radians: [P, count, 3]."""
    out = np.empty((len(normals), count, 3), np.float32)
    turned_directions(cosine_directions(count).astype(np.float32), normals.astype(np.float32), turn.astype(np.float32), out)
    return out
