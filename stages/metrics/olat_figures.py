"""Light-stage maps against their truth, and against their own frames where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.light_stage.folders import home_of
from pipeline.formats import dataset_files as files
from pipeline.formats.ground_truth import Truth, camera_maps
from pipeline.formats.images import RGB, XYZ, read_exr, read_image

from .image_figures import angle_deg, erode
from .olat_map_figures import add_map_figures
from .table import Table

NORMALS = ("diffuse_normal", "specular_normal", "normal")
TRUE_FIGURES = (*NORMALS, "albedo_rel_median", "albedo_rel_mean")
RIM = 2  # pixels at the silhouette are partly background
DARKEST = 0.02  # albedo below which a relative error means nothing


def olat_table(olat: Path, truth: Truth) -> Table:
    """One part per camera, a row for each, and the rows' means."""
    table = Table()
    for folder in files.subfolders(olat):
        part = _camera(folder, truth)
        table.parts[folder.name] = part
        table.rows.append({"view": folder.name, **_flat(part.figures)})
    table.means()
    return table


def _flat(figures: dict[str, Any]) -> dict[str, Any]:
    """Scalars of a camera with full names: normal_median_deg and so on."""
    out: dict[str, Any] = {}
    for name, value in figures.items():
        if isinstance(value, dict):
            out |= {f"{name}_{k}_deg": v for k, v in value.items()}
        elif isinstance(value, list):
            out |= {f"{name}_{axis}": v for axis, v in zip("uv", value)}
        else:
            out[name] = value
    return out


def _camera(folder: Path, ground_truth: Truth) -> Table:
    part = Table()
    residual = read_exr(files.camera_map(folder, "residual"))
    flag, sigma = residual["flag"], read_image(files.camera_map(folder, "sigma"), ("X", "Y"))
    specular = read_image(files.camera_map(folder, "specular_albedo"), ("Y",))[..., 0]
    fitted = np.linalg.norm(read_image(files.camera_map(folder, "normal"), XYZ), axis=-1) > 0.5
    truth = camera_maps(home_of(ground_truth.root, folder.name))
    inside = fitted if truth is None else erode(truth["mask"] > 0.5, RIM)
    part.figures["pixels"] = int((fitted if truth is None else truth["mask"] > 0.5).sum())
    if not inside.any():
        part.missing([*TRUE_FIGURES, "sigma_median", "specular_albedo_median"], "no pixel was fitted")
        return part
    if truth is not None:
        for name in NORMALS:
            error = angle_deg(read_image(files.camera_map(folder, name), XYZ), truth["normal"])[inside]
            part.figures[name] = {
                "median": float(np.median(error)),
                "mean": float(error.mean()),
                "p90": float(np.percentile(error, 90)),
            }
        true = truth["albedo"][..., :3][inside]
        albedo = read_image(files.camera_map(folder, "diffuse_albedo"), RGB)[inside]
        relative = np.abs(albedo - true) / np.maximum(true, DARKEST)
        part.figures["albedo_rel_median"] = float(np.median(relative))
        part.figures["albedo_rel_mean"] = float(relative.mean())
    part.missing(TRUE_FIGURES, f"the capture has no {folder.name}/gt/maps.npz")
    part.figures["sigma_median"] = [float(v) for v in np.median(sigma[inside], 0)]
    part.figures["specular_albedo_median"] = float(np.median(specular[inside]))
    part.figures["residual_median"] = float(np.median(residual["Y"][inside]))
    part.figures["flagged_pct"] = float(100 * (flag[inside] > 0).mean())
    brdf = ground_truth.document("gt_brdf.json")
    _lobe(part, folder, brdf, truth, inside)
    add_map_figures(part, folder, brdf, truth, inside)
    return part


def _lobe(part: Table, folder: Path, brdf: dict | None, truth: dict[str, NDArray] | None, inside: NDArray) -> None:
    """Errors of the lobe's widths and of the direction of the larger one."""
    if truth is None or brdf is None:
        part.missing(["sigma_rel_error"], "the capture has no gt_brdf.json")
        return
    true = brdf["sigma"]
    part.figures["sigma_rel_error"] = [abs(x / y - 1) for x, y in zip(part.figures["sigma_median"], sorted(true, reverse=True))]
    if true[0] == true[1]:
        return
    if "dp_du" not in truth:
        part.missing(["tangent_median_deg"], f"{folder.name}/gt/maps.npz has no dp_du")
        return
    normal, along_u = truth["normal"][inside], truth["dp_du"][..., :3][inside].astype(np.float64)
    u = along_u - normal * (along_u * normal).sum(-1, keepdims=True)
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    u = np.divide(u, length, out=np.zeros_like(u), where=length > 0)
    axis = np.cross(normal, u) if true[1] > true[0] else u
    tangent = read_image(files.camera_map(folder, "tangent"), XYZ)[inside]
    there = (np.linalg.norm(tangent, axis=-1) > 0.5) & (length[:, 0] > 0)
    if there.any():
        error = angle_deg(tangent[there], axis[there])
        part.figures["tangent_median_deg"] = float(np.median(np.minimum(error, 180 - error)))
    part.missing(["tangent_median_deg"], "no pixel has a tangent")
