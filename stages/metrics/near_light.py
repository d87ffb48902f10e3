"""Is a lamp inside the scene? Highlights of distant light mirror one direction wherever on the object they lie; those of a lamp
nearby point at its place.

The model's light is distant, and it hides a near lamp well: what shades is put into the albedo, what shines into bent normals.
So the pictures themselves are asked: where a place of the surface is brighter than other views see it (the diffuse part is the
same for all of them), the view mirrored at the normal is the way to the light. Those ways are fitted with one direction d that
turns with the place x (in radii of the object, from its middle) as d - q x: q is the light's inverse distance, 0 from afar.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import read_gbuffer
from pipeline.formats.images import RGB, S0, channel_names, read_image
from pipeline.geometry.cameras import Camera, load_cameras
from pipeline.geometry.lens import frames_folder

Float = NDArray[np.float64]

VIEWS = 48  # looked at, at most
PLACES = 600  # of the surface a view
INSIDE = 0.9  # opacity from which a pixel shows the surface alone
FACING = 0.35  # cosine of the view below which Fresnel's rise, not the lobe, makes a place bright
SAME_DEPTH = 0.02  # of the depth: what another view sees there is the same place
FEWEST_VIEWS = 4  # of a place
DIM = 0.25  # quantile of a place's radiance over the views that is taken for its diffuse part
BRIGHTEST = (0.01, 0.03)  # shares of all places taken for highlights: both must say the same
FEWEST, FEWEST_SEEN = 40, 6  # highlights, and views that they lie in
LOBE = 0.2  # rad, of the fit's robust scale: a highlight's half width
NEAR = 0.08
"""Inverse distance (radii of the object) above which the light is near. A lamp at 1.9 radii gives 0.15 to 0.17 after 400 and
1500 steps (0.43 to 0.52 with true normals); distant light in ten captures -0.31 to -0.02: two sources, or a large one, make it
negative."""
UNKNOWN = 0.15  # error of q from which highlights tell nothing
GROUPS = 8  # of views, each left out once for the error of q


@dataclass(frozen=True)
class Places:
    """Places x [P, 3] (radii of the object, from its middle), ways to the light r [P, 3] (unit), the radiance [P] above other
    views', and the view [P]; the object's middle and radius in world units."""

    x: Float
    r: Float
    excess: Float
    view: NDArray[np.int64]
    middle: Float
    radius: float


@dataclass(frozen=True)
class Convergence:
    """Inverse distance q of the light (1 / radii), its standard error, the direction [3], and how many highlights tell."""

    q: float
    error: float
    direction: Float
    count: int

    @property
    def is_near(self) -> bool:
        """Whether a lamp is nearer than any that counts as distant."""
        return self.q > max(NEAR, self.error) and self.error < UNKNOWN


@dataclass(frozen=True)
class _Seen:
    camera: Camera
    shown: NDArray[np.bool_]
    normal: Float
    depth: Float
    place: Float
    radiance: Float


def near_light(inputs: Mapping[str, Path]) -> tuple[list[Convergence], str | None]:
    """What the highlights of a trained capture say, and the line for the user where they point at a near lamp."""
    places = places_of(_views(inputs), np.random.default_rng(0))
    if places is None:
        return [], None
    found = [c for share in BRIGHTEST if (c := convergence(places, share)) is not None]
    if len(found) < len(BRIGHTEST) or not all(c.is_near for c in found):
        return found, None
    q, direction = found[0].q, found[0].direction
    at = places.middle + direction * places.radius / q
    line = (
        f"the highlights point at a lamp inside the scene (at most {1 / q:.0f} radii of the object from its middle, towards "
        f"{', '.join(f'{v:.2g}' for v in at)}), but the model's light is distant: its albedo and normals hold what the lamp "
        "does, and relit images are wrong; take the pictures again with the lamp ten radii away or more, or diffuse"
    )
    return found, line


def _views(inputs: Mapping[str, Path]) -> list[_Seen]:
    cameras, folder = load_cameras(inputs["poses"] / files.CAMERAS), frames_folder(inputs)
    names = [v for v in sorted(cameras) if files.gbuffer(inputs["train"], v).is_file() and files.frame(folder, v).is_file()]
    chosen = [names[k] for k in np.unique(np.linspace(0, len(names) - 1, min(VIEWS, len(names))).round().astype(int))]
    return [view for name in chosen if (view := _seen(cameras[name], inputs["train"], folder, name)) is not None]


def _seen(camera: Camera, train: Path, folder: Path, name: str) -> _Seen | None:
    surface = read_gbuffer(files.gbuffer(train, name))
    path = files.frame(folder, name)
    radiance = read_image(path, S0 if set(S0) <= set(channel_names(path)) else RGB).mean(-1)
    if radiance.shape != surface.alpha.shape or radiance.shape != (camera.height, camera.width):
        return None
    rays = camera.rays()
    place = camera.centre + rays * (surface.depth / (rays @ camera.world_to_camera[2, :3]))[..., None]
    shown = (surface.alpha > INSIDE) & np.isfinite(place).all(-1) & np.isfinite(radiance)
    return _Seen(camera, shown, surface.normal.astype(float), surface.depth.astype(float), place, radiance.astype(float))


def places_of(views: Sequence[_Seen], rng: np.random.Generator) -> Places | None:
    """Places of the surface in every view, with what they shine more than other views see; None where there are too few."""
    parts = [_shining(k, view, views, rng) for k, view in enumerate(views)]
    if not sum(len(excess) for _, _, excess, _ in parts):
        return None
    x, r, excess, view = (np.concatenate(column) for column in zip(*parts))
    middle = x.mean(0)
    radius = float(np.percentile(np.linalg.norm(x - middle, axis=1), 95))
    if not radius > 0:
        return None
    return Places((x - middle) / radius, r, excess, view, middle, radius)


def _shining(
    index: int, view: _Seen, views: Sequence[_Seen], rng: np.random.Generator
) -> tuple[Float, Float, Float, NDArray[np.int64]]:
    towards = -view.camera.rays()
    cosine = (towards * view.normal).sum(-1)
    chosen = rng.permutation(np.flatnonzero((view.shown & (cosine > FACING)).ravel()))[:PLACES]
    place, normal, to = (a.reshape(-1, 3)[chosen] for a in (view.place, view.normal, towards))
    others = np.stack([_radiance_at(place, normal, other) for other in views])
    known = np.isfinite(others).sum(0) >= FEWEST_VIEWS
    place, normal, to, chosen = place[known], normal[known], to[known], chosen[known]
    excess = view.radiance.ravel()[chosen] - np.nanquantile(others[:, known], DIM, axis=0)
    mirrored = 2 * (to * normal).sum(-1, keepdims=True) * normal - to
    return place, mirrored, excess, np.full(len(excess), index)


def _radiance_at(place: Float, normal: Float, view: _Seen) -> Float:
    """What a view sees of places [P, 3]: radiance [P], NaN where they are hidden, oblique or outside."""
    camera = view.camera
    pixels, depth = camera.project(place)
    within = (depth > 0) & ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(-1)
    u, v = np.where(within[:, None], pixels, 0).astype(int).T
    towards = camera.centre - place
    cosine = (towards * normal).sum(-1) / np.maximum(np.linalg.norm(towards, axis=-1), 1e-12)
    there = within & view.shown[v, u] & (np.abs(view.depth[v, u] - depth) < SAME_DEPTH * depth)
    return np.where(there & (cosine > FACING), view.radiance[v, u], np.nan)


def convergence(places: Places, share: float) -> Convergence | None:
    """Where the highlights point, the brightest `share` of all places; None where too few views have any."""
    bright = places.excess > max(float(np.quantile(places.excess, 1 - share)), 0.0)
    views = places.view[bright]
    if bright.sum() < FEWEST or len(np.unique(views)) < FEWEST_SEEN:
        return None
    x, r, weight = places.x[bright], places.r[bright], places.excess[bright]
    weight = np.minimum(weight / weight.mean(), 3.0)
    start = _common_direction(r, weight)
    direction, q = _fit(x, r, weight, start)
    left_out = [_fit(x[keep], r[keep], weight[keep], start)[1] for k in range(GROUPS) if (keep := views % GROUPS != k).any()]
    error = float(np.sqrt((GROUPS - 1) * np.var(left_out)))  # the jackknife's
    return Convergence(q, error, direction, int(bright.sum()))


def _common_direction(r: Float, weight: Float) -> Float:
    """The direction [3] about which most of r [P, 3] lie."""
    direction = (weight[:, None] * r).sum(0)
    for _ in range(30):
        direction /= max(float(np.linalg.norm(direction)), 1e-12)
        off = np.arccos(np.clip(r @ direction, -1, 1))
        direction = ((weight / (1 + (off / (1.5 * LOBE)) ** 2) ** 2)[:, None] * r).sum(0)
    return np.asarray(direction / max(float(np.linalg.norm(direction)), 1e-12))


def _fit(x: Float, r: Float, weight: Float, start: Float) -> tuple[Float, float]:
    """Direction d and q for which d - q x, made unit, is nearest to r, robustly."""
    from scipy.optimize import least_squares

    across = np.linalg.svd(start[None])[2][1:]  # two directions across the start

    def direction(p: Float) -> Float:
        d = start + p[:2] @ across
        return np.asarray(d / np.linalg.norm(d))

    def off(p: Float) -> Float:
        to = direction(p) - p[2] * x
        to /= np.maximum(np.linalg.norm(to, axis=1, keepdims=True), 1e-12)
        squares = ((to - r) ** 2).sum(1)
        return np.asarray(np.sqrt(weight * np.log1p(squares / LOBE**2)))

    fits = [least_squares(off, [0.0, 0.0, q]) for q in (0.0, 0.4)]
    best = min(fits, key=lambda fit: float(fit.cost))
    return direction(best.x), float(best.x[2])
