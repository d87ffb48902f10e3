"""Give the splats of a hollowed surface to a model: those on untouched ground stay, the others make way for new ones."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from ..initialise.hull import HullMesh
from ..initialise.sampling import mesh_area, sample_evenly
from ..splats.gaussians import OPTIONAL, SplatModel, logit
from ..splats.optimiser import SurfaceAdam
from .hollow import DepthField

INHERITED = ("albedo", "roughness_offset", "ior_offset", *OPTIONAL)  # by a new splat from the nearest old one
OPACITY = 0.95  # as at the start
COVERED = 0.8  # of the spacing: a new splat nearer to an old one than this would only repeat it


@torch.no_grad()
def refit(
    model: SplatModel, adam: SurfaceAdam, field: DepthField, hollow: HullMesh, spacing: float, most: int, seed: int
) -> int | None:
    """Replace, in place, the splats over hollows by samples of the hollowed surface; returns how many are new,
    or None where hardly any splat would stay: nothing is changed then.

    spacing: wanted distance between neighbours; most: upper bound of the model's size afterwards. New splats take albedo
    and material from the nearest that stays; afterwards every splat's anchor is where it is now.
    """
    device = model["position"].device
    positions = model["position"].detach().cpu().double().numpy()
    normals = model.activated().normals.detach().cpu().double().numpy()
    stays = field.at(positions) <= 0
    rows = torch.as_tensor(np.flatnonzero(stays), device=device)
    if len(rows) < 10:
        return None
    tree = cKDTree(positions[stays])
    wanted = int(mesh_area(hollow) * 2 / np.sqrt(3) / spacing**2)
    samples = sample_evenly(hollow, max(wanted, 100), np.random.default_rng(seed))
    distance, nearest = tree.query(samples.points)
    same_side = (normals[stays][nearest] * samples.normals).sum(-1) > 0
    bare = np.flatnonzero((distance > COVERED * spacing) | (~same_side & (distance > 0.3 * spacing)))
    left = most - len(rows)
    if len(bare) > left:
        bare = np.random.default_rng(seed).permutation(bare)[: max(left, 0)]
    model.select(rows)
    adam.select(model.per_splat, rows)
    source = torch.as_tensor(nearest[bare], device=device)
    new = {name: model[name].detach()[source] for name in model.per_splat if name in INHERITED}
    points = torch.as_tensor(samples.points[bare], dtype=torch.float32, device=device)
    new |= {"anchor": points, "position": points}
    new["normal"] = torch.as_tensor(samples.normals[bare], dtype=torch.float32, device=device)
    scale = 0.5 * np.minimum(samples.spacing[bare], 2 * spacing)
    new["log_scale"] = torch.log(torch.as_tensor(scale, dtype=torch.float32, device=device))
    new["opacity"] = logit(OPACITY).to(device).expand(len(bare))
    for name in model.per_splat:
        old = model[name].detach() if name != "anchor" else model["position"].detach()
        model.tensors[name] = torch.cat([old, new[name]]).requires_grad_(True)
    adam.append(model.per_splat, len(bare))
    return len(bare)
