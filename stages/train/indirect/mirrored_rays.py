"""Which pixels of a view mirror the object itself: a ray each, but for those whose surroundings see nothing of it that way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from pipeline.optics.sphere import hemisphere_rule

from ..pixel_attributes import LEAST_ALPHA
from ..render_view import GBuffer
from ..splats.ray_kernels import turned_directions
from ..splats.splat_occlusion import CarriedHull
from ..views.view import View
from .mirror_kernels import doubtful, mark, shown

RINGS, AZIMUTHS = 4, 8  # rays of a sample
MOST_SAMPLES = 16384  # vertices that cast them: half a million rays, a tenth of a second
SPACINGS = 2.0  # between samples, a cell's width: of rays that are blocked 1.7 % are left out on a teapot, 0.3 % on Spot
MOST_CELLS = 48  # along the longest side


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
    thousand samples of the surface tell: each cell of a grid remembers in which directions its own and its neighbours' rays
    met the hull.

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
        turn = 2 * np.pi * rng.random(len(points)).astype(np.float32)
        directions = np.empty((len(points), RINGS * AZIMUTHS, 3), np.float32)
        turned_directions(hemisphere_rule(RINGS, AZIMUTHS)[0].astype(np.float32), normals, turn, directions)
        met = hull.rays.blocked((points + self.lift * normals)[:, None], directions)
        a, b, c = (hull.vertices[hull.triangles[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        self.low, high = points.min(0), points.max(0)
        width = max(SPACINGS * np.sqrt(area / len(points)), float((high - self.low).max()) / MOST_CELLS, 1e-9)
        self.scale = np.float32(1 / width)
        shape = (np.floor((high - self.low) / width).astype(int) + 1).clip(1, MOST_CELLS + 1)
        cells = np.zeros(tuple(shape), np.uint64)
        mark(points, directions, met, self.low, self.scale, cells)
        self.cells = with_neighbours(cells)

    def blocked(self, at: Shown) -> np.ndarray:
        """Whether each pixel's mirror ray meets the object [K]: "invisible", as Ref-Gaussian and PhyGaP call it."""
        count = len(at.points)
        rows, rays = np.empty(count, np.int64), np.empty((count, 6), np.float32)
        found = doubtful(at.points, at.normals, at.mirrored, self.lift, self.low, self.scale, self.cells, rows, rays)
        met = np.zeros(count, bool)
        met[rows[self.hull.met(rays[:found])[0]]] = True
        return met


def with_neighbours(cells: np.ndarray) -> np.ndarray:
    """Bits of cells [X, Y, Z] with those of the 26 around each."""
    out = cells
    for axis in range(3):
        before, out = np.moveaxis(out, axis, 0), out.copy()
        after = np.moveaxis(out, axis, 0)
        after[1:] |= before[:-1]
        after[:-1] |= before[1:]
    return out


def everywhere(values: np.ndarray, rows: np.ndarray, like: torch.Tensor) -> torch.Tensor:
    """Values [K, ...] of some rows of [P, ...], where `like` [P] has its rows; 0 elsewhere."""
    out = np.zeros((len(like), *values.shape[1:]), np.float32)
    out[rows] = values
    return torch.from_numpy(out).to(like.device)
