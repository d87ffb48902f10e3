"""Close the holes of a closed surface: splats made transparent although nothing but an inner side lies behind them.

A film that the hull spans over a hollow is rightly transparent: one looks through it at the outer side of what lies deeper.
Where training views see next to nothing of a surface (between legs, under a belly), its splats fade too, and a view held back
looks through the hole at the back of the opposite wall, which no opaque object shows.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.geometry.occluder import tangent_frames
from pipeline.geometry.rays import RayMesh

from .gaussians import SplatModel, logit

OPAQUE = 0.9  # opacity from which a splat surely hides what is behind it: nine in ten have more
RAISED = 0.95  # of a splat that closes a hole, as at the start
TILTS = ((0.0, 1), (30.0, 6), (60.0, 6))  # degrees from a splat's normal, and directions there, in which it is looked through
DISC = 1.5  # sigmas, of an opaque splat's half side: so wide, the squares of neighbours overlap as their Gaussians do
WIDTH = 0.5  # of the distance to its neighbours, of a raised splat's sigma: as at the start
NEIGHBOURS = 6  # of that distance
OUTSIDE = 4.0  # half-sizes of the object from a splat at which its rays begin: beyond all of it


@torch.no_grad()
def close_holes(model: SplatModel) -> int:
    """Make opaque, in place, the splats of a surface without openings that a view can look through at an inner side.

    Returns how many there were. Their sigma is at least that of a start, since fading splats shrink too.
    """
    from scipy.spatial import cKDTree

    splats = model.activated()
    means, normals = (t.cpu().double().numpy() for t in (splats.means, splats.normals))
    opacity, sigma = splats.opacities.cpu().numpy(), splats.scales[:, 0].cpu().double().numpy()
    faint, opaque = np.flatnonzero(opacity < OPAQUE), np.flatnonzero(opacity >= OPAQUE)
    if not len(faint) or not len(opaque):
        return 0
    through = looked_through(means[faint], normals[faint], means[opaque], normals[opaque], DISC * sigma[opaque])
    rows = faint[through]
    if not len(rows):
        return 0
    apart = cKDTree(means).query(means[rows], k=min(NEIGHBOURS + 1, len(means)))[0][:, 1:].mean(1)
    at = torch.as_tensor(rows, device=model["opacity"].device)
    model["opacity"][at] = logit(RAISED).to(at.device)
    wide = torch.as_tensor(np.log(np.maximum(sigma[rows], WIDTH * apart)), dtype=torch.float32, device=at.device)
    model["log_scale"][at] = wide
    return len(rows)


def looked_through(
    points: np.ndarray, normals: np.ndarray, means: np.ndarray, facing: np.ndarray, half_sides: np.ndarray
) -> NDArray[np.bool_]:
    """Whether a ray from outside through each point [M, 3] (unit outward normals) meets a square from behind first [M].

    The squares [K] stand for opaque splats: means, unit outward normals [K, 3] and half their sides [K].
    """
    x, y, _ = tangent_frames(facing).swapaxes(0, 1)
    corners = [means + half_sides[:, None] * (a * x + b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    first = 4 * np.arange(len(means))[:, None]
    triangles = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
    rays = RayMesh(np.stack(corners, 1).reshape(-1, 3), triangles)
    along_x, along_y, _ = tangent_frames(normals).swapaxes(0, 1)
    found = np.zeros(len(points), bool)
    for tilt, count in TILTS:
        for turn in np.arange(count) * 2 * np.pi / count:
            side = np.cos(turn) * along_x + np.sin(turn) * along_y
            inward = -np.cos(np.radians(tilt)) * normals - np.sin(np.radians(tilt)) * side
            hits = rays.cast(points - OUTSIDE * inward, inward)
            behind = hits.hit & (hits.distance > OUTSIDE - half_sides.mean())
            square = np.where(behind, hits.triangle % len(means), 0)
            found |= behind & ((facing[square] * inward).sum(-1) > 0)
    return found
