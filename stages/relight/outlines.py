"""Pixels of a view that show more than one surface: silhouettes from the mesh, and no bright rims within the object.

A G-buffer blends the normals and materials of all that a pixel shows, and light does not follow the blend: where a front
meets what lies behind it, or the sky, the blended normal may mirror a lamp that neither surface sees. On the silhouette the
mesh is seen by several rays a pixel, each at a place with its own normal, material and shadows, and their light is averaged.
Within the object the mesh may close gaps that the G-buffer shows: there it stands for a blend where all that its rays meet lies
at the distance of something around; elsewhere a blend is no brighter than what it lies between. A mesh closes webs, and a blend
leans to what lies behind: inside the mask, where their normals disagree, the darker of the two is taken, as what is too bright
there is what one sees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pipeline.formats.backdrop import grown
from pipeline.geometry.cameras import Camera

from .deferred import Surface
from .mesh_images import BakedMesh

OPAQUE = 0.98  # opacity from which a pixel shows the object alone
STEADY = 0.7  # cosine between neighbours' normals (45 degrees): beyond, a pixel lies on two surfaces or on an edge
SIDE = 3  # rays a side of such a pixel
MISSED = 2.0  # pixels by which a mesh may miss the silhouette that the model has learnt
SLOPE = 4.0  # pixels that a surface may go away over one pixel and still be the one beside it
TURNED = 0.94  # cosine between the normals of a blend and of the mesh (20 degrees), below which one of them is wrong
TOLD = 0.05  # opacity from which the splats tell what they show
PAIRS = ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1]))  # of neighbours, down and across


def silhouette(alpha: NDArray, whole: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels [H, W] at the object's edge, of opacity alpha [H, W]; `whole` [H, W]: wholly inside the mask."""
    return (alpha < OPAQUE) & ~whole


def blended(normal: NDArray) -> NDArray[np.bool_]:
    """Pixels [H, W] with a neighbour whose normal [H, W, 3] (unit, 0 where nothing is) differs much."""
    turned = np.zeros(normal.shape[:2], bool)
    there = np.linalg.norm(normal, axis=-1) > 0.5
    for first, second in PAIRS:
        apart = ((normal[first] * normal[second]).sum(-1) < STEADY) & there[first] & there[second]
        turned[first] |= apart
        turned[second] |= apart
    return turned


def without_bright_rims(stokes: NDArray[np.float32], rim: NDArray[np.bool_], shown: NDArray[np.bool_]) -> NDArray[np.float32]:
    """A Stokes image [H, W, 3, 3] whose `rim` pixels [H, W] are no brighter than the brightest of the eight around them that
    are `shown` and no rim themselves, channel by channel; where there are none they stay."""
    from scipy.ndimage import maximum_filter

    steady = np.where((shown & ~rim)[..., None], stokes[:, :, 0], -1.0)
    bound = maximum_filter(steady, (3, 3, 1), mode="constant", cval=-1.0)
    over = rim[..., None] & (bound >= 0) & (stokes[:, :, 0] > bound)
    factor = np.where(over, bound / np.where(over, stokes[:, :, 0], 1), 1)
    return stokes * factor[:, :, None].astype(np.float32)


def interior(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels [H, W] of a mask whose four neighbours are in it too: wholly covered, as far as a mask can tell."""
    inner = np.pad(mask, 1)
    return mask & inner[:-2, 1:-1] & inner[2:, 1:-1] & inner[1:-1, :-2] & inner[1:-1, 2:]


@dataclass(frozen=True)
class Inner:
    """Pixels within the object that blend surfaces or lack opacity, and how far what they lie between is from the camera.

    wanted [H, W]; distance [H, W] of pixels that show one surface, NaN elsewhere; pixel: a pixel's width at distance 1.
    """

    wanted: NDArray[np.bool_]
    distance: NDArray
    pixel: float

    def fits(self, pixels: NDArray[np.int64], points: NDArray[np.int64], distance: NDArray) -> NDArray[np.bool_]:
        """Whether all rays of pixels (flat indices [U]) meet what lies around: points [U, R], -1 for none, at distances [M]."""
        padded = np.pad(self.distance, 1, constant_values=np.nan)
        row, column = np.divmod(pixels, self.distance.shape[1])
        around = np.stack([padded[row + y, column + x] for y in range(3) for x in range(3)], -1)
        met = np.append(distance, np.inf)[points]
        off = np.nan_to_num(np.abs(met[:, :, None] - around[:, None]), nan=np.inf).min(-1)
        return (off <= SLOPE * self.pixel * met).all(1) & (points >= 0).all(1)


@dataclass(frozen=True)
class Outlines:
    """What a view's blended pixels show: `rows` [U] of its shaded pixels, and the mean [U, M] of M points that rays meet."""

    rows: NDArray[np.int64]
    surface: Surface
    mean: csr_matrix
    coverage: NDArray[np.float32]  # [U] share of each pixel's own rays that meet the mesh, as far as they are used
    doubted: NDArray[np.bool_]  # [U] whose blend may be right and their points wrong

    @property
    def met(self) -> NDArray[np.bool_]:
        """Pixels that points stand for [U]."""
        return np.diff(self.mean.indptr) > 0

    def replaced(self, stokes: NDArray[np.float32], of_mesh: NDArray[np.float32]) -> NDArray[np.float32]:
        """A view's Stokes vectors [P, 3, 3] with the mean of their points' [M, 3, 3] where there are any, and where these are
        doubted, none of those that are brighter."""
        out = stokes.copy()
        means = (self.mean @ np.nan_to_num(of_mesh).reshape(len(of_mesh), 9)).reshape(-1, 3, 3)
        brighter = means[:, 0].sum(-1) > np.nan_to_num(stokes[self.rows, 0]).sum(-1)
        taken = self.met & ~(self.doubted & brighter)
        out[self.rows[taken]] = means[taken]
        return out

    def doubting(self, normal: NDArray, told: NDArray[np.bool_]) -> Outlines:
        """The same, doubted where the points' mean normal is far from the blend's: normal [P, 3] of the view's shaded pixels,
        told [P]: those that can be right."""
        of_mesh = self.mean @ self.surface.normal
        cosine = (of_mesh * normal[self.rows]).sum(-1)
        return replace(self, doubted=told[self.rows] & (cosine < TURNED * np.linalg.norm(of_mesh, axis=-1)))


def find_outlines(
    mesh: BakedMesh, camera: Camera, index: NDArray[np.int64], edge: NDArray[np.bool_], inner: Inner | None = None
) -> Outlines:
    """Of the shaded pixels with flat indices `index` [P], those at the `edge` [H, W], and those within where surfaces meet.

    A ray beside the mesh, at a pixel that the model covers in part, is one that the mesh misses by less than a pixel: it takes
    the nearest points that rays of its surroundings meet, as if the silhouette were moved there.
    """
    at_edge = edge.ravel()[index]
    within = inner.wanted.ravel()[index] & ~at_edge if inner is not None else np.zeros(len(index), bool)
    rows = np.flatnonzero(at_edge | within)
    shown = np.zeros(edge.shape, bool)
    shown.ravel()[index[at_edge]] = True
    pixels = np.union1d(index[rows], np.flatnonzero(grown(shown)))
    seen = mesh.seen_at(camera, pixels, SIDE)
    point = np.full(len(seen.hit), -1)
    point[seen.hit] = np.arange(int(seen.hit.sum()))
    own = point.reshape(-1, SIDE * SIDE)[np.searchsorted(pixels, index[rows])]
    if inner is not None:
        depth = np.linalg.norm(seen.surface.position - camera.centre, axis=1)
        own[within[rows] & ~inner.fits(index[rows], own, depth)] = -1
    coverage = (own >= 0).mean(1, dtype=np.float32)
    bare = at_edge[rows] & (own < 0).all(1)
    own[bare] = _nearest(pixels, point, index[rows[bare]], camera.width)
    row, column = np.nonzero(own >= 0)
    share = 1 / np.bincount(row, minlength=len(rows)).clip(1)
    used, point = np.unique(own[row, column], return_inverse=True)
    mean = csr_matrix((share[row], (row, point)), shape=(len(rows), len(used)))
    return Outlines(rows, seen.surface.part(used), mean, coverage, np.zeros(len(rows), bool))


def _nearest(pixels: NDArray[np.int64], point: NDArray[np.int64], bare: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """The points [B, SIDE * SIDE] that stand for pixels `bare` [B] whose own rays meet nothing, SIDE at most, -1 beyond them.

    pixels [N] (flat indices) and what their rays met, `point` [N * SIDE * SIDE], -1 for nothing.
    """
    from scipy.spatial import cKDTree

    out = np.full((len(bare), SIDE * SIDE), -1)
    down, across = np.divmod(np.arange(SIDE * SIDE), SIDE)
    row, column = np.divmod(pixels, width)
    place = np.stack([row[:, None] + (down + 0.5) / SIDE, column[:, None] + (across + 0.5) / SIDE], -1).reshape(-1, 2)
    met = point >= 0
    if not len(bare) or met.sum() < SIDE:
        return out
    distance, nearest = cKDTree(place[met]).query(np.stack(np.divmod(bare, width), -1) + 0.5, k=SIDE)
    out[:, :SIDE] = np.where(distance <= MISSED, point[met][nearest], -1)
    return out
