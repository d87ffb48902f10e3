"""Every camera's distances: integrated from its normals, set where the other cameras' maps agree with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from . import agreement_kernel
from .integrate import Pixels, edge_weights, integrated, pixels_of
from .map_view import MapView

Float = NDArray[np.float64]
LEAST_FACING = 0.2  # cosine below which a camera's sample of a point is a smear
ALBEDO_TOLERANCE = 0.25  # of the albedo's own size: where cameras differ by more they see other places
WEAK = 1e-3  # trust in a distance that only stands in: what the normals join it to decides


@dataclass(frozen=True)
class Round:
    """One pass of the search: reach and step along the ray and blur across the image in pixel footprints, tolerance of normals
    (rad)."""

    reach: float
    step: float
    blur: float
    tolerance: float


ROUNDS = (
    Round(np.inf, 1.0, 4.0, 0.35), Round(12.0, 0.75, 3.0, 0.25), Round(6.0, 0.5, 2.0, 0.2), Round(3.0, 0.25, 1.5, 0.15),
    Round(2.0, 0.2, 1.0, 0.12),
)  # fmt: skip


def find_depths(
    views: Sequence[MapView], chords: Sequence[tuple[Float, Float]], known: Sequence[Float] | None = None
) -> list[Float]:
    """Distance along the ray of every pixel [H, W] of each view, 0 where there is none.

    chords: where each pixel's ray enters and leaves the silhouettes' hull [H, W] each, 0 where it misses.
    known: distances [H, W] to a surface that all views together made (infinite beside it): the last round alone, from there.
    """
    found = [pixels_of(view) for view in views]
    near = [c[0][p.rows, p.columns] for p, c in zip(found, chords)]
    far = [c[1][p.rows, p.columns] for p, c in zip(found, chords)]
    if known is None:
        distances = [_beginning(pixels, a) for pixels, a in zip(found, near)]
    else:
        distances = [_begun(pixels, image[pixels.rows, pixels.columns]) for pixels, image in zip(found, known)]
    for number, each in enumerate(ROUNDS):
        if known is not None and each is not ROUNDS[-1]:
            continue
        surfaces = [p.image(d) if number else np.zeros(p.view.mask.shape) for p, d in zip(found, distances)]
        distances = [refined(k, found, distances[k], surfaces, (near[k], far[k]), each, number) for k in range(len(found))]
    return [pixels.image(d) for pixels, d in zip(found, distances)]


def _beginning(pixels: Pixels, near: Float) -> Float:
    """Distances [P] to begin with: about where the rays enter the hull [P], shaped by the normals."""
    start = np.where(near > 0, near, float(np.median(near[near > 0])))
    return integrated(pixels, start, np.where(near > 0, WEAK, WEAK * 0.1), edge_weights(pixels, start, 2.0))


def _begun(pixels: Pixels, known: Float) -> Float:
    """Distances [P] where a surface is known, and where it is not what the normals make of the nearest that are."""
    met = np.isfinite(known) & (known > 0)
    if met.all() or not met.any():
        return known if met.any() else _beginning(pixels, np.ones(len(known)))
    _, nearest = cKDTree(np.stack([pixels.rows[met], pixels.columns[met]], -1)).query(
        np.stack([pixels.rows[~met], pixels.columns[~met]], -1)
    )
    start = known.copy()
    start[~met] = known[met][nearest]
    return start


def supports(views: Sequence[MapView], distances: Sequence[Float]) -> list[Float]:
    """How far the other cameras bear out each view's distances [H, W]: the weight of those that agree about the point without
    that of those that do not, over a pixel's surroundings; 0 where no other camera sees it."""
    found, last = [pixels_of(view) for view in views], ROUNDS[-1]
    out = []
    for k, pixels in enumerate(found):
        base = distances[k][pixels.rows, pixels.columns]
        cost, weight = disagreement(k, found, base, np.ones(1), distances, last.tolerance)
        said = pixels.image(weight[:, 0].astype(np.float64) - 2.0 * cost[:, 0])  # costs are of the weight: all or none of it
        out.append(ndimage.gaussian_filter(said, last.blur))
    return out


def refined(
    k: int,
    found: Sequence[Pixels],
    base: Float,
    surfaces: Sequence[Float],
    chord: tuple[Float, Float],
    each: Round,
    number: int,
) -> Float:
    """One camera's distances [P] after one round."""
    pixels = found[k]
    foot = pixels.angle  # per unit of distance
    offset, trust = best_offsets(k, found, base, surfaces, chord, each)
    target = base * np.exp(offset * foot)
    distance = base
    weights = edge_weights(pixels, base, 1.0) if number else np.ones(len(pixels.edges))
    for _ in range(6):
        off = (distance - target) / (foot * target)
        robust = 1.0 / (1.0 + (off / (1.0 + each.blur)) ** 2) ** 2 if _ else 1.0
        distance = integrated(pixels, target, trust * robust + 1e-6, weights)
        weights = edge_weights(pixels, distance)
    return distance


def best_offsets(
    k: int, found: Sequence[Pixels], base: Float, surfaces: Sequence[Float], chord: tuple[Float, Float], each: Round
) -> tuple[Float, Float]:
    """Offset [P] in footprints at which a window about each pixel of camera k agrees best, and how far it is to be trusted."""
    pixels = found[k]
    foot = pixels.angle
    low, high = -each.reach, each.reach
    if not np.isfinite(each.reach):
        hit = chord[0] > 0
        low = float(np.quantile(np.log(chord[0][hit] / base[hit]), 0.02)) / foot - 2
        high = float(np.quantile(np.log(chord[1][hit] / base[hit]), 0.9)) / foot + 2
    steps = np.arange(low, high + each.step, each.step)
    cost, weight = disagreement(k, found, base, np.exp(steps * foot), surfaces, each.tolerance)
    mean = np.empty_like(cost)
    evidence = np.empty_like(cost)
    for s in range(len(steps)):
        mean[:, s], evidence[:, s] = (
            ndimage.gaussian_filter(pixels.image(values[:, s].astype(np.float64)), each.blur)[pixels.rows, pixels.columns]
            for values in (cost, weight)
        )
    mean = np.where(evidence > 1e-3, mean / np.maximum(evidence, 1e-3), 1.0)
    at = mean.argmin(1)
    index = np.arange(len(at))
    inner = np.clip(at, 1, len(steps) - 2)
    a, b, c = (mean[index, inner + d] for d in (-1, 0, 1))
    bend = a - 2 * b + c
    sound = (at == inner) & (bend > 1e-6)
    shift = np.where(sound, 0.5 * (a - c) / np.maximum(bend, 1e-6), 0.0)
    offset = steps[at] + np.clip(shift, -0.5, 0.5) * each.step
    curvature = bend / each.step**2 * each.tolerance**2 / 4e-4  # of squared misses of normals, in units of (0.02 rad)²
    trust = np.where(sound, curvature, 0.0) * np.clip(1 - 2 * mean[index, at], 0, 1) ** 2
    return offset, trust


def disagreement(
    k: int, found: Sequence[Pixels], base: Float, factors: Float, surfaces: Sequence[Float], tolerance: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """See `agreement_kernel.disagreements`: costs and weights [P, S] of camera k at `factors` on its distances."""
    pixels = found[k]
    others = [p.view for j, p in enumerate(found) if j != k]
    height, width = (max(v.mask.shape[axis] for v in others) for axis in (0, 1))
    features = np.zeros((len(others), height, width, 6), np.float32)
    masks, seen = (np.zeros((len(others), height, width), np.float32) for _ in range(2))
    rest = [s for j, s in enumerate(surfaces) if j != k]
    for j, (view, surface) in enumerate(zip(others, rest)):
        h, w = view.mask.shape
        features[j, :h, :w, :3], features[j, :h, :w, 3:] = view.normal, view.albedo
        masks[j, :h, :w], seen[j, :h, :w] = view.mask, surface
    own = np.concatenate([pixels.normals, pixels.view.albedo[pixels.rows, pixels.columns]], -1).astype(np.float32)
    level = max(float(np.mean(own[:, 3:])), 1e-6)
    scales = (tolerance**-2, (ALBEDO_TOLERANCE * level) ** -2 / 3.0, LEAST_FACING, 4 * pixels.angle)
    poses = np.stack([v.camera.world_to_camera[:3] for v in others])
    lenses = np.array([(v.camera.fx, v.camera.fy, v.camera.cx, v.camera.cy) for v in others])
    sizes = np.array([(v.camera.width, v.camera.height) for v in others])
    cost, weight = (np.zeros((len(base), len(factors)), np.float32) for _ in range(2))
    agreement_kernel.disagreements(
        pixels.rays, base, factors, own, pixels.view.camera.centre, features, masks, seen, poses,
        np.stack([v.camera.centre for v in others]), lenses, sizes, scales, cost, weight,
    )  # fmt: skip
    return cost, weight
