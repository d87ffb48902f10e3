"""Even samples of a mesh's surface: points, outward normals, spacing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .hull import HullMesh


@dataclass(frozen=True)
class SurfaceSamples:
    """Points [N, 3], unit outward normals [N, 3], mean distance to the nearest neighbours [N]."""

    points: np.ndarray
    normals: np.ndarray
    spacing: np.ndarray


def mesh_area(mesh: HullMesh) -> float:
    """Surface area of the mesh."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum())


def wanted_count(area: float, pixel: float, splat_pixels: float, maximum: int) -> int:
    """How many samples cover `area` at `splat_pixels` pixels apart in a hexagonal pattern; `pixel` = a pixel's size there."""
    return int(np.clip(area * 2 / np.sqrt(3) / (splat_pixels * pixel) ** 2, 200, maximum))


def sample_evenly(mesh: HullMesh, count: int, rng: np.random.Generator) -> SurfaceSamples:
    """About `count` Poisson-disk samples of the surface, relaxed towards equal spacing, near ones near in memory."""
    dense, normals = _random_samples(mesh, 5 * count, rng)
    radius = np.sqrt(mesh_area(mesh) / count * 0.72)  # a maximal Poisson-disk pattern covers about 0.72 of a hexagonal one
    for _ in range(2):
        kept = _poisson_disk(dense, normals, radius)
        radius *= np.sqrt(len(kept) / count)
    kept = _poisson_disk(dense, normals, radius)
    points, directions = _relaxed(dense[kept], dense, normals, rounds=4)
    order = along_curve(points)
    points, directions = points[order], directions[order]
    distance, _ = cKDTree(points).query(points, k=7)
    return SurfaceSamples(points, directions, distance[:, 1:].mean(1))


def along_curve(points: np.ndarray) -> np.ndarray:
    """An order of points [N, 3] in which neighbours in space mostly are neighbours in memory: that of their Morton codes."""
    low = points.min(0)
    cells = ((points - low) * (1023 / max(float((points.max(0) - low).max()), 1e-30))).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def _random_samples(mesh: HullMesh, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    corners = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    chosen = rng.choice(len(area), count, p=area / area.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - u, u * (1 - v), u * v], -1)[..., None]
    points = (corners[chosen] * weights).sum(1)
    normals = (mesh.normals[mesh.triangles[chosen]] * weights).sum(1)
    return points, normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)


def _poisson_disk(points: np.ndarray, normals: np.ndarray, radius: float) -> np.ndarray:
    """Indices of a greedy subset in which no two points on the same side of the surface are nearer than `radius`."""
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    pairs = pairs[(normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(-1) > 0]
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    starts = np.searchsorted(both[:, 0], np.arange(len(points) + 1))
    blocked = np.zeros(len(points), bool)
    kept = []
    for i in range(len(points)):
        if not blocked[i]:
            kept.append(i)
            blocked[both[starts[i] : starts[i + 1], 1]] = True
    return np.array(kept)


def _relaxed(points: np.ndarray, dense: np.ndarray, normals: np.ndarray, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """Lloyd's rounds on the dense samples: every point moves to its cell's mean, then onto the surface."""
    tree = cKDTree(dense)
    for _ in range(rounds):
        owner = cKDTree(points).query(dense)[1]
        number = np.maximum(np.bincount(owner, minlength=len(points)), 1)
        mean = np.stack([np.bincount(owner, dense[:, k], minlength=len(points)) for k in range(3)], -1) / number[:, None]
        nearest = tree.query(np.where(np.bincount(owner, minlength=len(points))[:, None] > 0, mean, points))[1]
        points = dense[nearest]
    owner = cKDTree(points).query(dense)[1]
    same = (normals * normals[tree.query(points)[1]][owner]).sum(-1) > 0.3
    summed = np.stack([np.bincount(owner[same], normals[same, k], minlength=len(points)) for k in range(3)], -1)
    summed += 1e-3 * normals[tree.query(points)[1]]  # a cell whose samples all face elsewhere keeps its own normal
    return points, summed / np.linalg.norm(summed, axis=-1, keepdims=True)
