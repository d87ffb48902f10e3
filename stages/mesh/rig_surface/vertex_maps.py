"""All cameras' maps on points of the surface: fused by inverse variance, with what the cameras disagree about."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.surface.map_view import inside_frame, sampled

from .sights import Sight

Float = NDArray[np.float64]
LEAST_FACING = 0.2  # cosine below which a camera's pixel is a smear of the surface
SQUARE = 0.35  # cosine from which a camera counts on its own: one beyond it only where no better one sees the point
LEAST = 1e-4  # a specular albedo or width below it is as good as none
NORMAL_FLOOR = 0.2  # degrees to which registration and a pixel's size leave a normal uncertain, however little noise there is
ALBEDO_FLOOR, WIDTH_FLOOR = 0.01, 0.02  # the same of albedos and widths, relative
OUTLIER = 3.0  # standard deviations at which a camera's value begins to lose its weight (Geman and McClure)
ONE_WAY = 0.75  # order of the cameras' tangents below which there is no one tangent
NORMAL, ALBEDO, SPECULAR, SIGMA, TANGENT = (
    slice(0, 3), slice(3, 6), slice(6, 7), slice(7, 9), slice(9, 12)
)  # of a camera's values of a vertex  # fmt: skip
WIDTH = 12
TOGETHER = 1 << 15  # vertices fused at a time: with eight cameras some 60 MB
BOX = 1.0 / 12.0  # variance of a place in a pixel, in squared pixels: what a pixel's mean hides of a slope


@dataclass(frozen=True)
class SurfacePoints:
    """Points of the surface: position [V, 3] and outward unit normal of the mesh [V, 3], world."""

    position: Float
    normal: Float


@dataclass(frozen=True)
class CameraValues:
    """What one camera says of V points: values [V, 12] (normal, diffuse albedo, specular albedo, widths, tangent), variances
    [V, 4] of the normal's angle (rad²), a diffuse albedo, the logarithms of specular albedo and a width; weights [V, 2] of
    the surface and the lobe (0: not seen)."""

    values: NDArray[np.float32]
    variance: NDArray[np.float32]
    weight: NDArray[np.float32]


def camera_values(sight: Sight, points: SurfacePoints, slack: float) -> CameraValues:
    """What a camera's maps hold where it sees the points, none of the four pixels about which may be on another surface.

    A map's variance is its noise, and what its pixels do not resolve: a camera that sees the surface squarely and closely blurs
    it least, and counts most where there is detail.
    """
    maps, camera = sight.maps, sight.maps.camera
    pixels, away = maps.view().project(points.position)
    towards = (camera.centre - points.position) / away[:, None]
    facing = (towards * points.normal).sum(1)
    at = np.flatnonzero(inside_frame(pixels, camera.width, camera.height) & (facing > LEAST_FACING))
    own, far = pixels[at], away[at]
    corner = np.floor(own).astype(np.int64)
    tolerance = slack / np.maximum(facing[at], LEAST_FACING)
    near = np.ones(len(at), bool)
    shown = {"surface": near.copy(), "lobe": near.copy()}
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        row, column = np.minimum(corner[:, 1] + down, camera.height - 1), np.minimum(corner[:, 0] + right, camera.width - 1)
        with np.errstate(invalid="ignore"):
            near &= np.abs(sight.surface[row, column] - far) < tolerance
        shown["surface"] &= maps.sound[row, column]
        shown["lobe"] &= maps.lobed[row, column]
    names = ("normal", "diffuse_albedo", "specular_albedo", "sigma", "tangent")
    found = np.concatenate([sampled(maps.maps[n].astype(np.float64), own) for n in names], -1)
    values, variance, weight = (np.zeros((len(points.position), n), np.float32) for n in (WIDTH, 4, 2))
    values[at], variance[at] = found, _variances(sight, own, found)
    share = np.clip((facing[at] - LEAST_FACING) / (SQUARE - LEAST_FACING), 0.01, 1.0) * facing[at] ** 2
    weight[at] = share[:, None] * (near[:, None] & np.stack([shown["surface"], shown["lobe"]], -1))
    return CameraValues(values, variance, weight)


def _variances(sight: Sight, pixels: Float, found: Float) -> Float:
    """Variances [N, 4] at pixels [N, 2] with values [N, 12], as `CameraValues` holds them."""
    maps = sight.maps
    std = {n: sampled(maps.maps[f"std_{n}"].astype(np.float64), pixels)[:, 0] for n in
           ("diffuse_normal", "diffuse_albedo", "specular_albedo", "sigma")}  # fmt: skip
    normal, albedo, specular, sigma = (
        BOX * sampled(sight.slopes[n].astype(np.float64), pixels)
        for n in ("normal", "diffuse_albedo", "specular_albedo", "sigma")
    )
    grey = np.maximum(found[:, ALBEDO].mean(1), 1e-6)
    bright, wide = np.maximum(found[:, SPECULAR][:, 0], 1e-6), np.maximum(found[:, SIGMA].mean(1), 1e-6)
    return np.stack([
        np.radians(1) ** 2 * (std["diffuse_normal"] ** 2 + NORMAL_FLOOR**2) + normal,
        std["diffuse_albedo"] ** 2 + (ALBEDO_FLOOR * grey) ** 2 + albedo,
        (std["specular_albedo"] ** 2 + specular) / bright**2 + ALBEDO_FLOOR**2,
        (std["sigma"] ** 2 + sigma) / wide**2 + WIDTH_FLOOR**2,
    ], -1)  # fmt: skip


def fused_maps(cameras: Iterable[CameraValues], geometric: Float) -> dict[str, NDArray]:
    """Vertex attributes [V, ...] by name from what the cameras say, and `coverage` [V], the number of cameras.

    geometric [V, 3]: unit normals of the mesh, where the cameras have none. Vertices that none sees take what the nearest seen
    one has later on: see `filled`. They are fused `TOGETHER` at a time, as the means take several times what the cameras say.
    """
    found = list(cameras)
    own = [slice(start, start + TOGETHER) for start in range(0, len(geometric), TOGETHER)] or [slice(0, 0)]
    parts = [_fused([CameraValues(c.values[k], c.variance[k], c.weight[k]) for c in found], geometric[k]) for k in own]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _fused(found: list[CameraValues], geometric: Float) -> dict[str, NDArray]:
    values, variance = np.stack([c.values for c in found]), np.stack([c.variance for c in found])
    share = np.stack([c.weight for c in found])
    out: dict[str, NDArray] = {"coverage": (share[..., 0] > 0).sum(0), "lobe_coverage": (share[..., 1] > 0).sum(0)}
    surface, lobed = share[..., 0], share[..., 1]
    normal, std, off = _mean(values[..., NORMAL], variance[..., 0], surface, 1)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    out["normal"] = np.where(length > 0.1, normal / np.maximum(length, 1e-9), geometric)
    out["std_diffuse_normal"], out["disagreement_normal"] = np.degrees(std), np.degrees(off)
    out["albedo"], out["std_diffuse_albedo"], off = _mean(values[..., ALBEDO], variance[..., 1], surface, 3)
    out["disagreement_albedo"] = off / np.maximum(out["albedo"].mean(1), 1e-6)
    for name, std_name, part, which in (("specular", "std_specular_albedo", SPECULAR, 2), ("sigma", "std_sigma", SIGMA, 3)):
        logs = np.log(np.maximum(values[..., part], LEAST))
        mean, std, off = _mean(logs, variance[..., which], lobed, part.stop - part.start)
        out[name] = np.where((out["lobe_coverage"] > 0)[:, None], np.exp(mean), 0.0)
        out[std_name], out[f"disagreement_{name}"] = out[name].mean(1) * std, off
    out["specular"] = out["specular"][:, 0]
    out["tangent"] = _tangents(values[..., TANGENT], lobed / np.maximum(variance[..., 3], 1e-12), out["normal"])
    return out


def _mean(values: NDArray, variance: NDArray, share: NDArray, parts: int) -> tuple[Float, Float, Float]:
    """Mean [V, K] of values [C, V, K] by share over variance [C, V], without outliers; the standard deviation of each of its
    `parts` [V], and the cameras' spread about it [V]. The variance is that of each part: 1 part is all K together.

    Where the cameras differ by more than their variances the deviation grows by as much (Birge ratio).
    """
    weight = np.where(share > 0, share / np.maximum(variance, 1e-12), 0.0).astype(np.float64)
    count = (share > 0).sum(0)
    for _ in range(3):
        total = np.maximum(weight.sum(0), 1e-30)
        mean = (weight[..., None] * values).sum(0) / total[:, None]
        square = ((values - mean) ** 2).sum(-1)
        spread = (weight * square).sum(0) / total
        scale = np.where(count > 2, np.maximum(spread, 1e-12), np.inf)  # two cameras have no majority
        base = np.where(share > 0, share / np.maximum(variance, 1e-12), 0.0)
        weight = base / (1.0 + square / (OUTLIER**2 * scale)) ** 2
    facing = np.where(share > 0, np.minimum(share / np.maximum(share.max(0), 1e-9), 1.0), 0.0)
    independent = np.maximum((facing / np.maximum(variance, 1e-12)).sum(0), 1e-12)
    excess = (weight * square / np.maximum(variance, 1e-12)).sum(0) / total / parts
    birge = np.where(count > 1, np.maximum(excess * count / np.maximum(count - 1, 1), 1.0), 1.0)
    return mean, np.sqrt(birge / independent), np.sqrt(spread / parts * count / np.maximum(count - 1, 1)) * (count > 1)


def _tangents(tangents: NDArray, weight: NDArray, normal: Float) -> Float:
    """Direction [V, 3] that most of the cameras' tangents [C, V, 3] share (either sign), 0 where there is none."""
    length = np.linalg.norm(tangents, axis=-1)
    directed = np.where(length > 0.5, weight, 0.0)
    unit = tangents / np.maximum(length, 1e-9)[..., None]
    moment = np.einsum("cv,cvi,cvj->vij", directed, unit, unit)
    value, vector = np.linalg.eigh(moment)
    top = vector[..., 2]
    top = top - (top * normal).sum(1, keepdims=True) * normal
    top /= np.maximum(np.linalg.norm(top, axis=1, keepdims=True), 1e-9)
    total = directed.sum(0)
    order = np.divide(value[:, 2] - value[:, 1], value.sum(1), out=np.zeros(len(total)), where=value.sum(1) > 0)
    return np.where(((order > ONE_WAY) & (total > 0.5 * weight.sum(0)))[:, None], top, 0.0)


def filled(position: Float, attributes: dict[str, NDArray], geometric: Float) -> dict[str, NDArray]:
    """The attributes of points [V, 3] with the nearest seen one's where no camera sees one: material there, the mesh's normal
    [V, 3]."""
    from scipy.spatial import cKDTree

    out = dict(attributes)
    lobe = ("specular", "sigma", "std_specular_albedo", "std_sigma", "disagreement_specular", "disagreement_sigma")
    for names, seen in (
        (("albedo", "std_diffuse_normal", "std_diffuse_albedo", "disagreement_normal", "disagreement_albedo"),
         attributes["coverage"] > 0),
        (lobe, attributes["lobe_coverage"] > 0),
    ):  # fmt: skip
        if not seen.any() or seen.all():
            continue
        _, nearest = cKDTree(position[seen]).query(position[~seen])
        for name in names:
            values = out[name].copy()
            values[~seen] = values[seen][nearest]
            out[name] = values
    out["normal"] = np.where((attributes["coverage"] > 0)[:, None], out["normal"], geometric)
    out["tangent"] = np.where((attributes["lobe_coverage"] > 0)[:, None], out["tangent"], 0.0)
    return out
