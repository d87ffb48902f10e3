"""Which pixels of a view mirror the object itself: a ray each, but for those whose surroundings see nothing of it that way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from pipeline.optics.sphere import hemisphere_rule

from ..pixel_attributes import LEAST_ALPHA
from ..render_view import GBuffer
from ..splats.blocked_directions import BlockedDirections
from ..splats.carried_hull import CarriedHull
from ..splats.ray_kernels import turned_directions
from ..views.view import View
from .mirror_kernels import shown

RINGS, AZIMUTHS = 4, 8  # rays of a sample
MOST_SAMPLES = 16384  # vertices that cast them: half a million rays, a tenth of a second
CELL = 2.0  # spacings of the samples: with 3 some 0.5 % of a teapot's blocked rays are left out, and a quarter more are cast


@dataclass(frozen=True)
class Shown:
    """The K pixels of a view that show the object: rows [K] among its counting pixels; position, unit normal, unit direction to
    the camera and the direction mirrored [K, 3], float32."""

    rows: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    view: np.ndarray
    mirrored: np.ndarray


def shown_surface(view: View, gbuffer: GBuffer) -> Shown:
    """Which of a view's counting pixels show the object, and where."""
    g, count = gbuffer, len(gbuffer.alpha)
    camera = view.world_to_camera
    centre, forward = -camera[:3, :3].T @ camera[:3, 3], camera[2, :3]
    tensors = (g.alpha, g.raster.depth_expected.reshape(-1), g.normal, view.view_direction, centre, forward)
    alpha, depth, normals, towards, middle, axis = (t.detach().contiguous().cpu().numpy() for t in tensors)
    rows = np.empty(count, np.int64)
    points, normal, back, mirrored = (np.empty((count, 3), np.float32) for _ in range(4))
    pixels = view.pixels.cpu().numpy()
    found = shown(
        pixels, alpha, np.float32(LEAST_ALPHA), depth, normals, towards, middle, axis, rows, points, normal, back, mirrored
    )
    return Shown(rows[:found], points[:found], normal[:found], back[:found], mirrored[:found])


class MirroredRays:
    """Rays that a view's pixels mirror, cast at the hull. Those are left out that nothing lies in the way of, as far as a few
    thousand samples of the surface tell (`BlockedDirections`): 1.7 % of those that are blocked on a teapot, 0.3 % on Spot.

    Args:
        hull: what they are cast at.
        lift: how far off the surface they begin.
        seed: of the samples.
    """

    def __init__(self, hull: CarriedHull, lift: float, seed: int = 0) -> None:
        self.hull, self.lift = hull, np.float32(lift)
        rng = np.random.default_rng(seed)
        count = len(hull.vertices)
        chosen = rng.choice(count, min(MOST_SAMPLES, count), replace=False)
        points, normals = (np.ascontiguousarray(a[chosen], np.float32) for a in (hull.vertices, hull.normals))
        points += self.lift * normals
        turn = 2 * np.pi * rng.random(len(points)).astype(np.float32)
        directions = np.empty((len(points), RINGS * AZIMUTHS, 3), np.float32)
        turned_directions(hemisphere_rule(RINGS, AZIMUTHS)[0].astype(np.float32), normals, turn, directions)
        a, b, c = (hull.vertices[hull.triangles[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        self.seen = BlockedDirections(points, CELL * float(np.sqrt(area / len(points))))
        self.seen.note(points, directions, hull.rays.blocked(points[:, None], directions))
        self.seen.settle()

    def blocked(self, at: Shown) -> np.ndarray:
        """Whether each pixel's mirror ray meets the object [K]: "invisible", as Ref-Gaussian and PhyGaP call it."""
        rows, rays = self.seen.doubtful(at.points + self.lift * at.normals, at.mirrored[:, None])
        met = np.zeros(len(at.points), bool)
        met[rows[self.hull.met(rays)[0]]] = True
        return met


def everywhere(values: np.ndarray, rows: np.ndarray, like: torch.Tensor) -> torch.Tensor:
    """Values [K, ...] of some rows of [P, ...], where `like` [P] has its rows; 0 elsewhere."""
    out = np.zeros((len(like), *values.shape[1:]), np.float32)
    out[rows] = values
    return torch.from_numpy(out).to(like.device)
