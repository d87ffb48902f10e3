"""Do the masks agree? Each is held against the visual hull of the others.

A voxel is carved by every view that sees background there. A mask pixel none of whose voxels survive is contradicted:
by this mask being too large, or by another being too small. A ray that only one other view has carved empty blames it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray

from pipeline.formats.backdrop import grown
from pipeline.geometry.cameras import Camera
from pipeline.kernels.compiling import kernel
from stages.masks.background import BALL_MARGIN, Fixation, fixation
from stages.masks.volume import Grid, Projections, pixel_of, stack_padded

GRID = 96
FLAG = 0.05
"""Of the mask's area (excess) or of the object's (blame): beyond what voxels of this size and soft edges leave."""


@dataclass(frozen=True)
class Agreement:
    """`excess`: share of a mask that no hull of the others explains; `blame`: area of other masks that this one alone
    contradicts, in units of the object's mean area."""

    excess: float
    blame: float

    @property
    def suspicious(self) -> bool:
        return self.excess > FLAG or self.blame > FLAG


def check_masks_agree(masks: list[NDArray[np.bool_]], cameras: list[Camera]) -> list[Agreement] | None:
    """The agreement of each mask [h, w] with all others; None where the cameras do not look at one thing."""
    ball = fixation(cameras)
    if ball is None or len(masks) < 3:
        return None
    grid = _grid(masks, cameras, ball)
    projections = Projections.of(cameras)
    solid = stack_padded(masks, bool)
    against = np.zeros((grid.count,) * 3, np.int32)
    culprit = np.full((grid.count,) * 3, -1, np.int32)
    outline = np.stack([grown(mask) for mask in solid])  # a voxel on the border must not be carved by rounding
    _count(outline, projections.forward, projections.sizes, grid.low, grid.step, against, culprit)
    excess = np.zeros(len(masks))
    blame = np.zeros((len(masks), len(masks)))
    _explain(
        solid, projections.back, projections.centres, projections.sizes, grid.low, grid.step, against, culprit, excess, blame
    )
    area = np.array([max(1, int(m.sum())) for m in masks])
    return [Agreement(float(excess[v] / area[v]), float((blame[:, v] / area).sum())) for v in range(len(masks))]


def _grid(masks: list[NDArray[np.bool_]], cameras: list[Camera], ball: Fixation) -> Grid:
    """A cube around the ball, no larger than the masks ask for."""
    reach = 0.0
    for mask, camera in zip(masks, cameras):
        if mask.any():
            rays = camera.rays()[mask]
            distance = np.linalg.norm(np.cross(rays, ball.centre - camera.centre), axis=-1)
            reach = max(reach, float(np.percentile(distance, 99.5)))
    half = min(BALL_MARGIN * ball.radius, 1.05 * reach) if reach > 0 else ball.radius
    return Grid(ball.centre - half, 2 * half / GRID, GRID)


@kernel(parallel=True)
def _count(solid, forward, sizes, low, step, against, culprit):
    n = against.shape[0]
    for plane in prange(n):
        z = low[2] + (plane + 0.5) * step
        for row in range(n):
            y = low[1] + (row + 0.5) * step
            for column in range(n):
                x = low[0] + (column + 0.5) * step
                for v in range(forward.shape[0]):
                    u, t = pixel_of(forward[v], x, y, z)
                    if 0 <= u < sizes[v, 0] and 0 <= t < sizes[v, 1] and not solid[v, t, u]:
                        against[plane, row, column] += 1
                        culprit[plane, row, column] = v


@kernel
def _explain(solid, back, centres, sizes, low, step, against, culprit, excess, blame):
    n = against.shape[0]
    for v in range(solid.shape[0]):
        origin = centres[v] - low
        for t in range(sizes[v, 1]):
            for u in range(sizes[v, 0]):
                if not solid[v, t, u]:
                    continue
                b = back[v]
                d = b[:, 0] * (u + 0.5) + b[:, 1] * (t + 0.5) + b[:, 2]
                d = d / np.sqrt((d * d).sum())
                middle = -((origin - n * step / 2) * d).sum()  # nearest to the cube's centre
                best, who = 1 << 30, -1
                s = middle - n * step * 0.87  # half the cube's diagonal
                while s < middle + n * step * 0.87:
                    i, j, k = (
                        int((origin[0] + s * d[0]) / step),
                        int((origin[1] + s * d[1]) / step),
                        int((origin[2] + s * d[2]) / step),
                    )
                    if 0 <= i < n and 0 <= j < n and 0 <= k < n:
                        if against[k, j, i] < best:
                            best, who = against[k, j, i], culprit[k, j, i]
                        if best == 0:
                            break
                    s += 0.7 * step
                if 0 < best < 1 << 30:
                    if best == 1 and who != v:
                        blame[v, who] += 1
                    else:
                        excess[v] += 1
