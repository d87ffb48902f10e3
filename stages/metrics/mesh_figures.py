"""Distance between two surfaces by dense samples, in percent of the true one's longest side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.dataset_files import DISAGREEMENT, MESH, POISSON
from pipeline.formats.images import read_exr
from pipeline.formats.obj import read_obj
from pipeline.formats.ply import Ply
from pipeline.geometry.rays import RayMesh
from pipeline.geometry.world_offset import stored_offset

from .mesh_quality import quality
from .table import Table

FIGURES = ("chamfer_pct", "accuracy_pct", "completeness_pct", "fscore_1pct")
DISTANCES = ("chamfer", "accuracy", "completeness")
MILLIMETRES = tuple(f"{name}_mm" for name in DISTANCES)


def sample(vertices: NDArray, faces: NDArray, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """`count` points [count, 3], uniform by area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not area.sum() > 0:
        raise ValueError("the mesh has no area")
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    root, u = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    return (1 - root) * a[chosen] + root * (1 - u) * b[chosen] + root * u * c[chosen]


def surface_figures(mesh: tuple[NDArray, NDArray], truth: tuple[NDArray, NDArray], count: int) -> dict[str, float]:
    """Accuracy (mesh to truth), completeness (truth to mesh), their mean, and the F-score at 1 % of the true size."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(1)
    a, b = sample(*mesh, count, rng), sample(*truth, count, rng)
    size = float((truth[0].max(0) - truth[0].min(0)).max())
    to_truth, to_mesh = cKDTree(b).query(a, workers=-1)[0], cKDTree(a).query(b, workers=-1)[0]
    precision, recall = (max(float((d < 0.01 * size).mean()), 1e-9) for d in (to_truth, to_mesh))
    return {
        "chamfer_pct": float(50 * (to_truth.mean() + to_mesh.mean()) / size),
        "accuracy_pct": float(100 * to_truth.mean() / size),
        "completeness_pct": float(100 * to_mesh.mean() / size),
        "fscore_1pct": 2 / (1 / precision + 1 / recall),
    }


def read_mesh(path: Path) -> tuple[NDArray, NDArray]:
    """Vertices [V, 3] and triangles [F, 3] of a PLY or OBJ mesh. Raises UserError."""
    if path.suffix == ".obj":
        vertices, triangles = read_obj(path)
    else:
        ply = Ply(path)
        vertices, triangles = ply.vertices(), ply.triangles()
    if not len(triangles):
        raise UserError(path, "holds no triangle", "mend or remove it")
    return vertices, triangles


def mesh_table(folder: Path, truth: Path, count: int, unit_m: float | None = None) -> Table:
    """Figures of mesh.ply and, as the part `poisson`, of mesh_poisson.ply; `unit_m`: metres of a world unit, where known."""
    true = read_mesh(truth) if truth.is_file() else None
    table = _figures_of(folder / MESH, true, count, unit_m)
    if true is not None:
        table.figures |= seen_figures(folder / MESH, true)
    if (folder / POISSON).is_file():
        table.parts["poisson"] = _figures_of(folder / POISSON, true, count, unit_m)
    for path in sorted((folder / DISAGREEMENT).glob("*.exr")):
        found = read_exr(path)
        medians = {name: float(np.median(image[image > 0])) for name, image in found.items() if (image > 0).any()}
        table.rows.append({"view": path.stem, **{DISAGREEMENT_FIGURES[name]: v for name, v in medians.items()}})
    table.means()
    return table


def _figures_of(path: Path, truth: tuple[NDArray, NDArray] | None, count: int, unit_m: float | None) -> Table:
    """How one surface hangs together, and its distances to the true one."""
    table = Table()
    vertices, faces = read_mesh(path)
    table.figures["triangles"] = len(faces)
    table.figures |= quality(vertices, faces)
    table.missing(["genus"], "the surface is not closed")
    if truth is not None:
        table.figures |= surface_figures((vertices + stored_offset(path), faces), truth, count)
        size = float(np.ptp(truth[0], axis=0).max())
        if unit_m is not None:
            table.figures |= {f"{name}_mm": table.figures[f"{name}_pct"] / 100 * size * unit_m * 1000 for name in DISTANCES}
    table.missing(FIGURES, "the capture has no gt/mesh.ply")
    unknown = "the capture has no gt/mesh.ply" if truth is None else "capture.toml does not tell unit_m"
    table.missing(MILLIMETRES, unknown)
    return table


DISAGREEMENT_FIGURES = {
    "normal_deg": "disagreement_normal_deg", "diffuse_albedo": "disagreement_diffuse_albedo",
    "specular_albedo": "disagreement_specular_albedo", "sigma": "disagreement_sigma",
}  # fmt: skip
"""Channels of a light stage's disagreement maps, and the figure that the median of each is."""


def seen_figures(path: Path, truth: tuple[NDArray, NDArray]) -> dict[str, float]:
    """Of a light stage's mesh, distances of the vertices that a camera sees to the truth (percent of its longest side)."""
    ply = Ply(path)
    if "coverage" not in ply.elements["vertex"].columns:
        return {}
    seen = ply.vertices(("coverage",))[:, 0] > 0
    if not seen.any():
        return {}
    points = (ply.vertices() + stored_offset(path))[seen]
    size = float(np.ptp(truth[0], axis=0).max())
    away = np.linalg.norm(points - RayMesh(*truth).closest(points).position, axis=1) / size
    return {"seen_median_pct": float(100 * np.median(away)), "seen_p90_pct": float(100 * np.quantile(away, 0.9))}
