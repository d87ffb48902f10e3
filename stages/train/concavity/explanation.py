"""How badly the best normal and albedo explain what the views saw of a point, under the light and material so far."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from pipeline.kernels.threads import run_on_all_cores
from pipeline.optics import fresnel as optics
from pipeline.shading import LightField
from pipeline.shading.shading import body_transmission, mirror_reflection

from ..octahedral_map import octahedral_directions
from ..splats.gaussians import Splats
from .explanation_kernel import LEAST_COSINE, explain
from .samples import Observations

NORMALS = 400  # directions tried first, 10 degrees apart; the best one is then refined to a degree
TABLE = 128  # texels along a side of the direction tables: a texel is a degree
COSINES = 256


class Shading(NamedTuple):
    """Lookup tables of the split-sum shading for one material: irradiance and mirrored light by direction, octahedral maps
    [TABLE, TABLE, 3];
    by cosine [K, 4]: body transmission, its polarisation, mirror albedo, its polarisation (both over sin^2)."""

    irradiance: np.ndarray
    mirrored: np.ndarray
    angular: np.ndarray


@torch.no_grad()
def shading_tables(splats: Splats, light: LightField, fresnel: str) -> Shading:
    """Tables for the splats' median material under a light; `fresnel` is "exact" or "schlick".

    The residuals that matter here are far above what the material's variation makes.
    """
    device = splats.means.device
    roughness, ior = splats.roughness.median(), splats.ior.median()
    directions = torch.as_tensor(octahedral_directions(TABLE).reshape(-1, 3), device=device)
    irradiance = light.irradiance(directions, transmitted=fresnel == "exact")
    mirrored = light.mirrored(directions, roughness.expand(len(directions)))
    c = torch.linspace(LEAST_COSINE, 1, COSINES, device=device)
    eta = ior.expand(COSINES)
    axes = torch.eye(3, device=device)
    normal = torch.stack([torch.sqrt(1 - c * c), torch.zeros_like(c), c], -1)
    frame_x, frame_y = axes[0].expand(COSINES, 3), axes[1].expand(COSINES, 3)
    reflected, across = mirror_reflection(normal, c, roughness.expand(COSINES), eta, frame_x, frame_y, light.lobe, fresnel)
    angular = torch.stack([body_transmission(c, eta, fresnel), optics.diffuse_polarisation(c, eta), reflected, across], -1)
    tables = [a.reshape(TABLE, TABLE, 3).cpu().numpy().astype(np.float32) for a in (irradiance, mirrored)]
    return Shading(tables[0], tables[1], angular.cpu().numpy().astype(np.float32))


def unexplained(seen: Observations, albedo: np.ndarray, shading: Shading) -> np.ndarray:
    """Mean robust encoded residual [P] of each point's views at its best normal and albedo; inf where no view sees it.

    albedo [P, 3]: what to fall back on where nothing is lit.
    """
    count = len(seen.views)
    best = np.full(count, np.inf, np.float32)
    run_on_all_cores(explain, seen, shading, sphere_directions(NORMALS), albedo.astype(np.float32), best)
    return best


def sphere_directions(count: int) -> np.ndarray:
    """Even directions over the sphere (Fibonacci spiral), float32 [count, 3]."""
    k = np.arange(count) + 0.5
    up = 1 - 2 * k / count
    phi = k * np.pi * (3 - np.sqrt(5.0))
    sine = np.sqrt(1 - up * up)
    return np.stack([sine * np.cos(phi), up, sine * np.sin(phi)], -1).astype(np.float32)
