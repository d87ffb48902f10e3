"""Self-occlusion while training: shadow and bounced light per splat, blocked reflections per pixel, by ray casting.

The occluder is the visual hull's mesh carried along by the splats, so its topology stays and nothing is meshed anew.
What is traced enters shading as constants (no gradient) and is traced again every few hundred steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from pipeline.optics.sphere import cosine_directions
from pipeline.shading import LightField, Occlusion, shade

from .blocked_directions import BlockedDirections
from .carried_hull import CarriedHull
from .gaussians import Splats
from .ray_kernels import lobe_directions, turned_directions
from .surface_graph import SurfaceGraph

DIFFUSE_RAYS = 48  # cosine-weighted rays a splat; their noise is averaged over neighbours as well
BOUNCES = 2  # reflections of light between places of the object that are followed
AT_ONCE = 4096  # splats traced at a time: all 3 million rays at once were the run's peak of memory, 0.7 GiB
SCOUTS, CELL = 3, 3.0  # of so many rays a splat casts one first; those of splats in cells so many spacings wide tell which of
# the rest need casting: shadows lose 0.5 % (a teapot) and 0.9 % (Spot) of their depth, a twentieth of what 48 rays scatter by
SHADED_AT_ONCE = 262144  # blocked rays whose ends are shaded at a time
LOBE_RAYS = 6  # rays through a pixel's reflection lobe
SMOOTHING = 2  # diffusion rounds of the traced per-splat values
LIFT = 0.7  # splat spacings off the surface at which rays begin: the carried hull is coarser than the splats
SMOOTH_LEVEL = 0.55  # roughness of the light that one diffuse ray stands for: it spans the solid angle about it
GRAZING = 0.02  # cosine below which a reflected ray runs into its own surface and counts as free
FAR_TAIL = 0.999  # share of the lobe that rays are drawn from: the last 0.1 % reaches the horizon
GOLDEN = 0.618034  # golden section: azimuths of successive rays fill the circle evenly


@dataclass(frozen=True)
class SplatOcclusion:
    """Per splat: shadow [N, 3] (share of the irradiance that arrives) and bounced [N, 3] (irradiance off the object);
    `blocked`: mean share of blocked rays, 0 for a convex object; `seen`: in which directions they were blocked where."""

    shadow: torch.Tensor
    bounced: torch.Tensor
    blocked: float
    seen: BlockedDirections


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
    blocks = [slice(first, first + AT_ONCE) for first in range(0, len(normals), AT_ONCE)]
    seen = BlockedDirections(origins, CELL * graph.spacing)
    for rows in blocks:
        few = cosine_rays(DIFFUSE_RAYS, normals[rows], turn[rows])[:, ::SCOUTS]
        seen.note(origins[rows], few, occluder.rays.blocked(origins[rows, None], few))
    seen.settle()
    parts = [_trace_rows(occluder, seen, light, origins[rows], normals[rows], turn[rows], rows.start) for rows in blocks]
    shares, *hits = zip(*parts)
    ray, splat, towards = (np.concatenate(a) for a in hits)
    shadow = graph.diffuse(torch.cat(shares), SMOOTHING)
    blocked = len(ray) / (len(normals) * DIFFUSE_RAYS)
    found = SplatOcclusion(shadow, torch.zeros_like(shadow), blocked, seen)
    receiver = torch.as_tensor(ray, device=shadow.device)
    for _ in range(bounces if len(ray) else 0):
        sent = outgoing(splats, splat, towards, light, fresnel, lit(found, bounces))
        total = torch.zeros_like(shadow).index_add_(0, receiver, sent)
        found = replace(found, bounced=graph.diffuse(np.pi / DIFFUSE_RAYS * total, SMOOTHING))
    return found


def _trace_rows(
    occluder: CarriedHull,
    seen: BlockedDirections,
    light: LightField,
    origins: np.ndarray,
    normals: np.ndarray,
    turn: np.ndarray,
    first: int,
) -> tuple[torch.Tensor, np.ndarray, np.ndarray, np.ndarray]:
    """Shadow [R, 3] at some of the splats, and of their rays that are blocked: the splat they start from (numbered from
    `first`), the one they hit, and their direction [M, 3]."""
    device = light.packed.device
    directions = cosine_rays(DIFFUSE_RAYS, normals, turn)
    flat = directions.reshape(-1, 3)
    doubtful, rays = seen.doubtful(origins, directions)
    hit, splat = occluder.cast(rays)
    rows = doubtful[hit]
    roughness = torch.full((len(flat),), SMOOTH_LEVEL, device=device)
    radiance = light.mirrored(torch.as_tensor(flat, device=device), roughness)
    total = radiance.reshape(-1, DIFFUSE_RAYS, 3).sum(1)
    radiance[torch.as_tensor(rows, device=device)] = 0
    arriving = radiance.reshape(-1, DIFFUSE_RAYS, 3).sum(1)
    return arriving / total.clamp_min(1e-12), first + rows // DIFFUSE_RAYS, splat, flat[rows]


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
    origins = (points + LIFT * spacing * normals).astype(np.float32)
    doubtful, rays = received.seen.doubtful(origins, reflected)
    hit, splat = occluder.cast(rays)
    rows = doubtful[hit]
    above = rise.reshape(-1)[rows] > GRAZING
    rows, splat = rows[above], splat[above]
    seen, blocked = torch.zeros(count * LOBE_RAYS, 3, device=device), np.zeros((count, LOBE_RAYS), np.float32)
    if len(rows):
        there = torch.as_tensor(rows, device=device)
        seen[there] = outgoing(splats, splat, reflected.reshape(-1, 3)[rows], light, fresnel, received)
        blocked.reshape(-1)[rows] = 1
    unblocked = 1 - torch.as_tensor(blocked.mean(1), device=device)
    return unblocked, seen.reshape(count, LOBE_RAYS, 3).mean(1)


def cosine_rays(count: int, normals: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The cosine-weighted directions about each of the normals [P, 3], turned by `turn` [P] radians: [P, count, 3]."""
    out = np.empty((len(normals), count, 3), np.float32)
    turned_directions(cosine_directions(count).astype(np.float32), normals.astype(np.float32), turn.astype(np.float32), out)
    return out
